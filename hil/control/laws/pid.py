"""PID without feedforward: the industrial baseline the paper names."""

from typing import Any, ClassVar

from hil.control.gain import Gain, Knob, with_defaults
from hil.control.laws.base import Law, LawInputs, Model
from hil.control.laws.terms import (
    DAMPING,
    STIFFNESS,
    default_damping,
    default_stiffness,
    error,
    error_rate,
    unless_saturated,
)
from hil.control.number import Number, bounded, full_like, zeros_like


class Pid(Law):
    """tau = -Kp e - Ki int e dt - Kd ė + gravity hold (Astrom and Murray, Feedback Systems (2008), eq. (10.1)).

    Anti-windup: the integral force stays within the force limit and stops while it would push a saturated force further
    out.
    """

    GAINS: ClassVar[dict[str, Gain]] = {
        "kp": STIFFNESS,
        "kd": DAMPING,
        "ki": Gain(None, "N/(m s)", "integral gain; default: from kp and rate", tune=Knob(1e-4, 1e-2, "m/T3")),
    }

    def __init__(self, model: Model, period: float, force_limit: Number, **gains: Any) -> None:
        given = with_defaults(self.GAINS, gains)
        kp: Number | None = given["kp"]
        kd: Number | None = given["kd"]
        ki: Number | None = given["ki"]
        self._kp = default_stiffness(model, period) if kp is None else kp
        self._kd = default_damping(model, period) if kd is None else kd
        self._ki = self._kp * (0.02 / period) if ki is None else ki
        self._gravity = model.gravity
        self._period = period
        self._limit = force_limit
        self.reset(zeros_like(model.mass), model.gravity)

    def reset(self, position: Number, force: Number) -> None:
        """The integral takes over what `force` has beyond the gravity hold."""
        self._integral = bounded(full_like(position, force - self._gravity), self._limit)

    def force(self, inputs: LawInputs) -> Number:
        """The law of the class's docstring."""
        e = error(inputs)
        change = unless_saturated(-self._ki * e * self._period, inputs.force_last, self._limit)
        self._integral = bounded(self._integral + change, self._limit)
        return self._integral - self._kp * e - self._kd * error_rate(inputs) + self._gravity
