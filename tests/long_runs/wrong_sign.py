"""PID whose integrator has the wrong sign, as a users' law: no gain of a shipped one may be below zero."""

from typing import Any

from hil.control.laws.base import Model
from hil.control.laws.pid import Pid
from hil.control.number import Number


class WrongSign(Pid):
    """Drifts away, however slowly."""

    def __init__(self, model: Model, period: float, force_limit: Number, **gains: Any) -> None:
        super().__init__(model, period, force_limit, **gains)
        self._ki = -self._ki
