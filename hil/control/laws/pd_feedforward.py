"""PD plus feedforward: eq. (15) of Xu, Cai, Zou (2013)."""

from typing import Any, ClassVar

from hil.control.gain import Gain, with_defaults
from hil.control.laws.base import Law, LawInputs, Model
from hil.control.laws.terms import DAMPING, STIFFNESS, Feedforward, default_damping, default_stiffness
from hil.control.number import Number


class PdFeedforward(Law):
    """tau = -Kp e - Kd ė + M q̈d + N(q̇d) q̇d, with e = q - qd (eq. (15)).

    e and ė are taken where the force starts to act (Kalman estimate less reference, both at that instant). A constant
    disturbance D leaves the plateau e = D / Kp.
    """

    GAINS: ClassVar[dict[str, Gain]] = {"kp": STIFFNESS, "kd": DAMPING}

    def __init__(self, model: Model, period: float, force_limit: Number, **gains: Any) -> None:
        given = with_defaults(self.GAINS, gains)
        kp: Number | None = given["kp"]
        kd: Number | None = given["kd"]
        self._kp = default_stiffness(model, period) if kp is None else kp
        self._kd = default_damping(model, period) if kd is None else kd
        self._feedforward = Feedforward(model)

    def reset(self, position: Number, force: Number) -> None:
        """It remembers nothing."""

    def force(self, inputs: LawInputs) -> Number:
        """Eq. (15)."""
        start = inputs.start
        position, velocity = start.position - inputs.position_estimate, start.velocity - inputs.velocity_estimate
        return position * self._kp + velocity * self._kd + self._feedforward(inputs)
