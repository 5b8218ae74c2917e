"""Computed torque: the model inverted at the measured state; a baseline of the paper ([11, 12, 17])."""

from typing import Any, ClassVar

from hil.control.gain import Gain, Knob, with_defaults
from hil.control.laws.base import Law, LawInputs, Model
from hil.control.laws.terms import DAMPING, STIFFNESS, default_damping, default_stiffness, error, error_rate
from hil.control.number import Number, at_least, bounded


class ComputedTorque(Law):
    """tau = M q̈d - Kd ė - Kp e + N(q̇) q̇ (Siciliano et al., Robotics (2009), eqs. (8.56)-(8.59)).

    sgn(q̇) is taken as q̇ / sign_width within that speed: at zero speed the sign of an estimate is noise.
    """

    GAINS: ClassVar[dict[str, Gain]] = {
        "kp": STIFFNESS,
        "kd": DAMPING,
        # Narrower than coulomb over kd the loop oscillates at rest.
        "sign_width": Gain(0.01, "m/s", "speed within which sgn(q̇) is q̇ / sign_width", tune=Knob(1e-3, 0.5)),
    }

    def __init__(self, model: Model, period: float, force_limit: Number, **gains: Any) -> None:
        given = with_defaults(self.GAINS, gains)
        kp: Number | None = given["kp"]
        kd: Number | None = given["kd"]
        sign_width: Number = given["sign_width"]
        self._model = model
        self._kp = default_stiffness(model, period) if kp is None else kp
        self._kd = default_damping(model, period) if kd is None else kd
        self._width = at_least(sign_width, 1e-12)

    def reset(self, position: Number, force: Number) -> None:
        """It remembers nothing."""

    def force(self, inputs: LawInputs) -> Number:
        """The law of the class's docstring."""
        model = self._model
        # The speed in the middle of the interval: the estimate at its start, moved on as the reference moves.
        v = inputs.velocity_estimate + (inputs.mean_velocity - inputs.start.velocity)
        friction = model.coulomb * bounded(v / self._width, 1.0) + model.viscous * v + model.quadratic * (v * abs(v))
        feedback = self._kp * error(inputs) + self._kd * error_rate(inputs)
        return model.mass * inputs.mean_acceleration + friction + model.gravity - feedback
