"""Computed torque: the model inverted at the measured state; a baseline of the paper ([11, 12, 17])."""

from typing import Any, ClassVar

from hil.control.laws.base import Law, LawInputs, Model
from hil.control.laws.feedback import error, error_rate
from hil.control.laws.terms import default_damping, default_stiffness
from hil.control.number import Number, at_least, bounded


class ComputedTorque(Law):
    """tau = M q̈d - Kd ė - Kp e + N(q̇) q̇ (Siciliano et al., Robotics (2009), eqs. (8.56)-(8.59)).

    kp: N/m; kd: N s/m; None: from mass and rate. sign_width: m/s, within which sgn(q̇) is taken as q̇ / sign_width: at
    zero speed the sign of an estimate is noise.
    """

    name: ClassVar[str] = "computed-torque"
    GAINS: ClassVar[dict[str, Any]] = {"kp": None, "kd": None, "sign_width": 0.01}

    def __init__(
        self,
        model: Model,
        period: float,
        force_limit: Number,
        *,
        kp: Number | None = None,
        kd: Number | None = None,
        sign_width: Number = 0.01,
    ) -> None:
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
