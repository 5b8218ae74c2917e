"""Adaptive control of Slotine and Li (Int. J. Robotics Research 6(3), 1987); a baseline of the paper ([14, 15])."""

from typing import Any, ClassVar

from hil.control.gain import Gain, Knob, with_defaults
from hil.control.laws.base import Law, LawInputs, Model
from hil.control.laws.terms import Feedforward, default_damping, error, error_rate, unless_saturated
from hil.control.number import Number, bounded, select, zeros_like


class SlotineLi(Law):
    """tau = feedforward + Y a - M lambda ė - Kd s, da/dt = -Gamma Y' s, s = ė + lambda e, Y = [q̈r, sgn(q̇d), q̇d, 1].

    q̈r = q̈d - lambda ė. a corrects the nominal mass (kg), Coulomb friction (N), viscous friction (N s/m) and a constant
    force (N). rate: lambda. Adaptation gains are per unit of s. Estimates stay within bounds and stop while the force
    is saturated outwards.
    """

    GAINS: ClassVar[dict[str, Gain]] = {
        "rate": Gain(None, "1/s", "lambda; default: from the rate", tune=Knob(0.02, 0.4, "1/T")),
        "kd": Gain(None, "N s/m", "damping on s; default: from mass and rate", tune=Knob(0.05, 0.5, "m/T")),
        "mass_gain": Gain(1e-3, "kg^2/(N s)", "adaptation of the mass", tune=Knob(1e-7, 1e-2)),
        "coulomb_gain": Gain(10.0, "N/m", "adaptation of Coulomb friction", tune=Knob(0.1, 1e3)),
        "viscous_gain": Gain(1.0, "N s^2/m^2", "adaptation of viscous friction", tune=Knob(1e-3, 1e2)),
        "bias_gain": Gain(10.0, "N/m", "adaptation of the constant force", tune=Knob(0.1, 1e3)),
    }

    def __init__(self, model: Model, period: float, force_limit: Number, **gains: Any) -> None:
        given = with_defaults(self.GAINS, gains)
        rate: Number | None = given["rate"]
        kd: Number | None = given["kd"]
        self._feedforward = Feedforward(model)
        self._mass = model.mass
        self._gravity = model.gravity
        self._rate = 0.15 / period if rate is None else rate
        self._kd = 0.5 * default_damping(model, period) if kd is None else kd
        self._limit = force_limit
        third = force_limit / 3.0
        self._bounds = (0.5 * model.mass, third, third, third)
        adaptation: list[Number] = [
            given["mass_gain"],
            given["coulomb_gain"],
            given["viscous_gain"],
            given["bias_gain"],
        ]
        self._gains = tuple([gain * period for gain in adaptation])
        self.reset(zeros_like(model.mass), model.gravity)

    def reset(self, position: Number, force: Number) -> None:
        """Estimates restart; the bias takes over what `force` has beyond the gravity hold."""
        zero = zeros_like(position)
        bias = bounded(zero + (force - self._gravity), self._bounds[3])
        self._estimates = [zero, zero, zero, bias]

    def force(self, inputs: LawInputs) -> Number:
        """The law of the class's docstring."""
        e, rate = error(inputs), error_rate(inputs)
        s = rate + self._rate * e
        correction = self._rate * rate
        regressors = (inputs.mean_acceleration - correction, inputs.mean_sign, inputs.mean_velocity, 1.0)
        out = self._feedforward(inputs) - self._mass * correction - self._kd * s
        for index, regressor in enumerate(regressors):
            change = -self._gains[index] * regressor * s
            # What the change would add to the force decides whether it pushes outwards.
            push = unless_saturated(change * regressor, inputs.force_last, self._limit)
            change = select(push == 0.0, 0.0, change)
            self._estimates[index] = bounded(self._estimates[index] + change, self._bounds[index])
            out = out + self._estimates[index] * regressor
        return out
