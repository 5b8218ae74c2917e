"""PD-based robust control, eqs. (27) and (28) of Xu, Cai, Zou (2013), as printed and in two other readings."""

from typing import Any, ClassVar

import numpy as np

from hil.control.laws.base import Law, LawInputs, Model
from hil.control.laws.feedback import error, error_rate
from hil.control.laws.terms import Feedforward, default_damping, default_stiffness
from hil.control.number import Number, root, select

READINGS = ("printed", "filtered-error", "alpha-brackets")
NORMS = ("vector", "per-axis")


class RobustPd(Law):
    """tau = M q̈d + N q̇d - [alpha M + Kd] ė - [alpha N + Kp] e + u (27), u = alpha N e - nu (28).

    The law's alpha N e cancels between (27) and (28) and is not computed: 1/Ẋ in the printed N is unbounded. Readings:

    printed         -(alpha M + Kd) ė - Kp e - nu,            nu = ė rho^2 / (|ė| rho + epsilon - beta |e|^2)
    filtered-error  the same with s = ė + alpha e for ė in nu
    alpha-brackets  -alpha (M + Kd) ė - alpha Kp e - nu       (alpha before both brackets; nu as printed)

    |.| is the Euclidean norm over all axes (norm = vector) or each axis by itself (per-axis). kp: N/m; kd: N s/m; None:
    from mass and rate; alpha: 1/s; epsilon, rho: N, N m/s ... as printed. The printed denominator crosses zero at |e| =
    sqrt(epsilon / beta): it is held at or above `floor`, and `denominator_floors` counts how often.
    """

    name: ClassVar[str] = "robust-pd"
    READING: ClassVar[str] = ""  # of a class that has but one
    GAINS: ClassVar[dict[str, Any]] = {
        "kp": None,
        "kd": None,
        "alpha": 60.0,
        "epsilon": 0.001,
        "beta": 100.0,
        "rho": 0.3,
        "floor": 1e-4,
        "reading": "printed",
        "norm": "vector",
    }

    def __init__(
        self,
        model: Model,
        period: float,
        force_limit: Number,
        *,
        kp: Number | None = None,
        kd: Number | None = None,
        alpha: Number = 60.0,
        epsilon: Number = 0.001,
        beta: Number = 100.0,
        rho: Number = 0.3,
        floor: Number = 1e-4,
        reading: str = "printed",
        norm: str = "vector",
    ) -> None:
        reading = self.READING or reading
        for key, value, allowed in (("reading", reading, READINGS), ("norm", norm, NORMS)):
            if value not in allowed:
                raise ValueError(f"law.gains.{key} = {value!r}: expected one of {', '.join(allowed)}")
        if np.any(np.asarray(floor) <= 0.0):
            raise ValueError(f"law.gains.floor = {floor}: expected a number > 0")
        kp = default_stiffness(model, period) if kp is None else kp
        kd = default_damping(model, period) if kd is None else kd
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

    name: ClassVar[str] = "robust-pd-filtered-error"
    READING: ClassVar[str] = "filtered-error"
    GAINS: ClassVar[dict[str, Any]] = {key: value for key, value in RobustPd.GAINS.items() if key != "reading"}


class AlphaBracketsPd(RobustPd):
    """RobustPd in the reading alpha-brackets: a law of its own, with its own gains in a rig file."""

    name: ClassVar[str] = "robust-pd-alpha-brackets"
    READING: ClassVar[str] = "alpha-brackets"
    GAINS: ClassVar[dict[str, Any]] = FilteredErrorPd.GAINS
