"""Sliding mode with a boundary layer; one of the baselines the paper names ([13])."""

from typing import Any, ClassVar

from hil.control.gain import Gain, Knob, with_defaults
from hil.control.laws.base import Law, LawInputs, Model
from hil.control.laws.terms import Feedforward, error, error_rate
from hil.control.number import Number, at_least, bounded


class SlidingMode(Law):
    """tau = feedforward - M lambda ė - K sat(s / phi), s = ė + lambda e.

    Slotine and Li, Applied Nonlinear Control (1991), section 7.2.

    rate: lambda; reach: K; layer: phi. Inside the layer it is a PD loop with Kd = K / phi + lambda M and Kp = lambda K
    / phi.
    """

    GAINS: ClassVar[dict[str, Gain]] = {
        "rate": Gain(None, "1/s", "lambda; default: from the rate", tune=Knob(0.02, 0.4, "1/T")),
        "reach": Gain(None, "N", "K; default: from the force limit", tune=Knob(0.02, 0.5, "F")),
        "layer": Gain(None, "m/s", "phi; default: from reach, mass and rate", tune=Knob(1e-3, 1.0)),
    }

    def __init__(self, model: Model, period: float, force_limit: Number, **gains: Any) -> None:
        given = with_defaults(self.GAINS, gains)
        rate: Number | None = given["rate"]
        reach: Number | None = given["reach"]
        layer: Number | None = given["layer"]
        self._feedforward = Feedforward(model)
        self._rate = 0.15 / period if rate is None else rate
        self._reach = 0.2 * force_limit if reach is None else reach
        width: Number = self._reach * period / (0.2 * model.mass) if layer is None else layer
        self._inverse_layer = 1.0 / at_least(width, 1e-12)
        self._damping = model.mass * self._rate

    def reset(self, position: Number, force: Number) -> None:
        """It remembers nothing."""

    def force(self, inputs: LawInputs) -> Number:
        """The law of the class's docstring."""
        rate = error_rate(inputs)
        s = rate + self._rate * error(inputs)
        switching = self._reach * bounded(s * self._inverse_layer, 1.0)
        return self._feedforward(inputs) - self._damping * rate - switching
