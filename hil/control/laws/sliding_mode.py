"""Sliding mode with a boundary layer; one of the baselines the paper names ([13])."""

from typing import Any, ClassVar

from hil.control.laws.base import Law, LawInputs, Model
from hil.control.laws.feedback import error, error_rate
from hil.control.laws.terms import Feedforward
from hil.control.number import Number, at_least, bounded


class SlidingMode(Law):
    """tau = feedforward - M lambda ė - K sat(s / phi), s = ė + lambda e.

    Slotine and Li, Applied Nonlinear Control (1991), section 7.2.

    rate: lambda, 1/s; reach: K, N; layer: phi, m/s. None: from mass, rate and force limit. Inside the layer it is a PD
    loop with Kd = K / phi + lambda M and Kp = lambda K / phi.
    """

    name: ClassVar[str] = "sliding-mode"
    GAINS: ClassVar[dict[str, Any]] = {"rate": None, "reach": None, "layer": None}

    def __init__(
        self,
        model: Model,
        period: float,
        force_limit: Number,
        *,
        rate: Number | None = None,
        reach: Number | None = None,
        layer: Number | None = None,
    ) -> None:
        self._feedforward = Feedforward(model)
        self._rate = 0.15 / period if rate is None else rate
        self._reach = 0.2 * force_limit if reach is None else reach
        layer = self._reach * period / (0.2 * model.mass) if layer is None else layer
        self._inverse_layer = 1.0 / at_least(layer, 1e-12)
        self._damping = model.mass * self._rate

    def reset(self, position: Number, force: Number) -> None:
        """It remembers nothing."""

    def force(self, inputs: LawInputs) -> Number:
        """The law of the class's docstring."""
        rate = error_rate(inputs)
        s = rate + self._rate * error(inputs)
        switching = self._reach * bounded(s * self._inverse_layer, 1.0)
        return self._feedforward(inputs) - self._damping * rate - switching
