"""Super-twisting: second-order sliding mode, a continuous force that still rejects a bounded-rate disturbance."""

from typing import Any, ClassVar

from hil.control.gain import Gain, Knob, with_defaults
from hil.control.laws.base import Law, LawInputs, Model
from hil.control.laws.terms import Feedforward, error, error_rate, unless_saturated
from hil.control.number import Number, at_least, bounded, full_like, root, zeros_like


class SuperTwisting(Law):
    """tau = feedforward - M lambda ė - k1 |s|^(1/2) sgn(s) - w, dw/dt = k2 sgn(s), s = ė + lambda e.

    Levant, Int. J. Control 58(6), 1993.

    rate: lambda. linear: damping added on s, which keeps the sampled loop calm near s = 0. w stays within half the
    force limit and stops while it would push a saturated force further out.
    """

    GAINS: ClassVar[dict[str, Gain]] = {
        "rate": Gain(None, "1/s", "lambda; default: from the rate", tune=Knob(0.02, 0.4, "1/T")),
        "k1": Gain(None, "N (s/m)^(1/2)", "default: from the force limit", tune=Knob(1e-3, 1.0, "F")),
        "k2": Gain(None, "N/s", "default: from the force limit", tune=Knob(0.1, 100.0, "F")),
        "linear": Gain(None, "N s/m", "damping on s; default: from mass and rate", tune=Knob(0.02, 0.5, "m/T")),
        "smooth": Gain(1e-3, "m/s", "value of s within which sgn(s) is s / smooth", tune=Knob(1e-3, 1e-1)),
    }

    def __init__(self, model: Model, period: float, force_limit: Number, **gains: Any) -> None:
        given = with_defaults(self.GAINS, gains)
        rate: Number | None = given["rate"]
        k1: Number | None = given["k1"]
        k2: Number | None = given["k2"]
        linear: Number | None = given["linear"]
        smooth: Number = given["smooth"]
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
        self.reset(zeros_like(model.mass), model.gravity)

    def reset(self, position: Number, force: Number) -> None:
        """The integral term takes over what `force` has beyond the gravity hold."""
        self._w = bounded(full_like(position, force - self._gravity), self._bound)

    def force(self, inputs: LawInputs) -> Number:
        """The law of the class's docstring."""
        rate = error_rate(inputs)
        s = rate + self._rate * error(inputs)
        sign = bounded(s / self._smooth, 1.0)
        change = unless_saturated(-self._k2 * sign * self._period, inputs.force_last, self._limit)
        self._w = bounded(self._w + change, self._bound)
        reaching = self._k1 * root(abs(s)) * sign
        return self._feedforward(inputs) - self._damping * rate - self._linear * s - reaching + self._w
