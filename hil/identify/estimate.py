"""An identified quantity with its 95 % interval, and what could not be identified."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Student's t for 95 %, two-sided, by degrees of freedom from 1; normal beyond.
_T95 = (12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26, 2.23, 2.20, 2.18, 2.16, 2.14, 2.13, 2.12)


class Estimate(NamedTuple):
    """value and half width of its 95 % interval, in `unit` (SI)."""

    value: float
    half_width: float
    unit: str

    def holds(self, truth: float) -> bool:
        """Whether the interval contains it."""
        return abs(truth - self.value) <= self.half_width


WIDEST = 0.5  # half width over value of what is told


class Refused(Exception):
    """A quantity that the data cannot tell; `reason` is one sentence with value and limit."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


def damping(one: Estimate) -> Estimate:
    """A viscous coefficient, which is not negative: 0 where the interval allows that. Raises Refused."""
    if one.value + one.half_width < 0.0:
        raise Refused(f"{one.value:.3g} +- {one.half_width:.2g} {one.unit}: friction falls with speed (at least 0)")
    return one if one.value >= 0.0 else one._replace(value=0.0, half_width=one.half_width - one.value)


def t95(freedom: int) -> float:
    """Student's t for a 95 % interval. freedom: at least 1."""
    return _T95[freedom - 1] if freedom <= len(_T95) else 1.96 + 2.6 / freedom


def jackknife(without: Sequence[Array]) -> Array:
    """Half widths (k,) at 95 %, from the estimates (k,) that leave out one block of the data each."""
    each = np.array(without)
    n = len(each)
    spread: Array = np.sqrt((n - 1) / n * ((each - each.mean(axis=0)) ** 2).sum(axis=0))
    return t95(n - 1) * spread
