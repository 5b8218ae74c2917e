"""PD-based robust control, eqs. (27) and (28) of Xu, Cai, Zou (2013), as printed and in two other readings."""

from typing import Any, ClassVar

import numpy as np

from hil.control.gain import Gain, Knob, with_defaults
from hil.control.laws.base import Law, LawInputs, Model
from hil.control.laws.terms import (
    DAMPING,
    STIFFNESS,
    Feedforward,
    default_damping,
    default_stiffness,
    error,
    error_rate,
)
from hil.control.number import Number, root, select

SMALLEST = 2.2250738585072014e-308  # above 0


class RobustPd(Law):
    """tau = M q̈d + N q̇d - [alpha M + Kd] ė - [alpha N + Kp] e + u (27), u = alpha N e - nu (28).

    The law's alpha N e cancels between (27) and (28) and is not computed: 1/Ẋ in the printed N is unbounded. Readings:

        printed         -(alpha M + Kd) ė - Kp e - nu,            nu = ė rho^2 / (|ė| rho + epsilon - beta |e|^2)
        filtered-error  the same with s = ė + alpha e for ė in nu
        alpha-brackets  -alpha (M + Kd) ė - alpha Kp e - nu       (alpha before both brackets; nu as printed)

    |.| is the Euclidean norm over all axes (norm = vector) or each axis by itself (per-axis). The printed denominator
    crosses zero at |e| = sqrt(epsilon / beta): it is held at or above `floor`, and `denominator_floors` counts how
    often.
    """

    READING: ClassVar[str] = ""  # of a class that has but one
    GAINS: ClassVar[dict[str, Gain]] = {
        "kp": STIFFNESS,
        "kd": DAMPING,
        "alpha": Gain(60.0, "1/s", "as printed", tune=Knob(1e-3, 0.2, "1/T")),
        # Near rest nu is a damping of rho^2 / epsilon.
        "epsilon": Gain(0.001, "N m/s", "as printed", tune=Knob(0.05, 100.0, "T/m")),
        "beta": Gain(100.0, "N/(m s)", "as printed"),
        "rho": Gain(0.3, "N", "as printed: the bound of the disturbance"),
        "floor": Gain(1e-4, "N m/s", "least value of the denominator of nu", least=SMALLEST),
        "reading": Gain("printed", "", "of eqs. (27) and (28)", words=("printed", "filtered-error", "alpha-brackets")),
        "norm": Gain("vector", "", "|.| over all axes, or of each axis by itself", words=("vector", "per-axis")),
    }

    def __init__(self, model: Model, period: float, force_limit: Number, **gains: Any) -> None:
        given = with_defaults(self.GAINS, gains)
        given_kp: Number | None = given["kp"]
        given_kd: Number | None = given["kd"]
        alpha: Number = given["alpha"]
        epsilon: Number = given["epsilon"]
        beta: Number = given["beta"]
        rho: Number = given["rho"]
        floor: Number = given["floor"]
        norm: str = given["norm"]
        reading: str = self.READING or given["reading"]
        kp: Number = default_stiffness(model, period) if given_kp is None else given_kp
        kd: Number = default_damping(model, period) if given_kd is None else given_kd
        inside = reading == "alpha-brackets"
        self._stiffness = alpha * kp if inside else kp
        self._damping = alpha * (model.mass + kd) if inside else alpha * model.mass + kd
        self._slope = alpha if reading == "filtered-error" else 0.0
        self.coupled = norm == "vector"
        self._epsilon, self._beta, self._rho, self._floor = epsilon, beta, rho, floor
        self._rho2 = rho * rho
        self._feedforward = Feedforward(model)
        self.denominator_floors = 0

    def reset(self, position: Number, force: Number) -> None:
        """It remembers nothing; the count goes on."""

    def force(self, inputs: LawInputs) -> Number:
        """The law of the class's docstring."""
        e, rate = error(inputs), error_rate(inputs)
        s = rate + self._slope * e
        denominator = self._size(s) * self._rho + self._epsilon - self._beta * self._squared(e)
        low = denominator < self._floor
        self.denominator_floors += low if isinstance(low, bool) else int(np.count_nonzero(low))
        nu = s * self._rho2 / select(low, self._floor, denominator)
        return self._feedforward(inputs) - self._damping * rate - self._stiffness * e - nu

    def _squared(self, value: Number) -> Number:
        """|value|^2; over the axes in their order, so that a batch adds up as one plant does."""
        if not self.coupled:
            return value * value
        squares: Any = value * value
        total = squares[..., 0]
        for axis in range(1, squares.shape[-1]):
            total = total + squares[..., axis]
        each: Number = total[..., None] + np.zeros(squares.shape[-1])
        return each

    def _size(self, value: Number) -> Number:
        return root(self._squared(value)) if self.coupled else abs(value)


class FilteredErrorPd(RobustPd):
    """RobustPd in the reading filtered-error: a law of its own, with its own gains in a rig file."""

    READING: ClassVar[str] = "filtered-error"
    GAINS: ClassVar[dict[str, Gain]] = {key: value for key, value in RobustPd.GAINS.items() if key != "reading"}


class AlphaBracketsPd(RobustPd):
    """RobustPd in the reading alpha-brackets: a law of its own, with its own gains in a rig file."""

    READING: ClassVar[str] = "alpha-brackets"
    GAINS: ClassVar[dict[str, Gain]] = {
        **FilteredErrorPd.GAINS,  # alpha stands before kp and kd: other ranges
        "kp": STIFFNESS._replace(tune=Knob(0.02, 5.0, "m/T")),
        "kd": DAMPING._replace(tune=Knob(0.1, 100.0, "m")),
        "alpha": RobustPd.GAINS["alpha"]._replace(tune=Knob(5e-3, 0.3, "1/T")),
    }
