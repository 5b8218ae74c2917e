"""Super-twisting: second-order sliding mode, a continuous force that still rejects a bounded-rate disturbance."""

from typing import Any, ClassVar

from hil.control.laws.base import Law, LawInputs, Model
from hil.control.laws.feedback import error, error_rate, unless_saturated
from hil.control.laws.terms import Feedforward
from hil.control.number import Number, at_least, bounded, root


class SuperTwisting(Law):
    """tau = feedforward - M lambda ė - k1 |s|^(1/2) sgn(s) - w, dw/dt = k2 sgn(s), s = ė + lambda e.

    Levant, Int. J. Control 58(6), 1993.

    rate: lambda, 1/s; k1: N (s/m)^(1/2); k2: N/s; None: from mass, rate and force limit. linear: N s/m, damping added
    on s, which keeps the sampled loop calm near s = 0. smooth: m/s, within which sgn(s) is s / smooth. w stays within
    half the force limit and stops while it would push a saturated force further out.
    """

    name: ClassVar[str] = "super-twisting"
    GAINS: ClassVar[dict[str, Any]] = {"rate": None, "k1": None, "k2": None, "linear": None, "smooth": 1e-3}

    def __init__(
        self,
        model: Model,
        period: float,
        force_limit: Number,
        *,
        rate: Number | None = None,
        k1: Number | None = None,
        k2: Number | None = None,
        linear: Number | None = None,
        smooth: Number = 1e-3,
    ) -> None:
        self._feedforward = Feedforward(model)
        self._gravity = model.gravity
        self._period = period
        self._limit = force_limit
        self._bound = 0.5 * force_limit
        self._rate = 0.1 / period if rate is None else rate
        self._k1 = 0.1 * force_limit if k1 is None else k1
        self._k2 = 2.0 * force_limit if k2 is None else k2
        self._linear = model.mass * (0.1 / period) if linear is None else linear
        self._smooth = at_least(smooth, 1e-12)
        self._damping = model.mass * self._rate
        self.reset(model.mass - model.mass, model.gravity)

    def reset(self, position: Number, force: Number) -> None:
        """The integral term takes over what `force` has beyond the gravity hold."""
        self._w = bounded(position - position + (force - self._gravity), self._bound)

    def force(self, inputs: LawInputs) -> Number:
        """The law of the class's docstring."""
        rate = error_rate(inputs)
        s = rate + self._rate * error(inputs)
        sign = bounded(s / self._smooth, 1.0)
        change = unless_saturated(-self._k2 * sign * self._period, inputs.force_last, self._limit)
        self._w = bounded(self._w + change, self._bound)
        reaching = self._k1 * root(abs(s)) * sign
        return self._feedforward(inputs) - self._damping * rate - self._linear * s - reaching + self._w
