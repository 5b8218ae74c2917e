"""The correction of an encoder's scale along the travel: straight lines between places where it was measured."""

from bisect import bisect_right
from collections.abc import Sequence

import numpy as np

from hil.control.laws.base import Array


class ErrorMap:
    """positions: places by the encoder, m (rad), increasing, at least two. corrections: true less encoder, there.

    Beyond both ends the correction is that of the end. Numbers and arrays get the same bits.
    """

    __slots__ = ("_corrections", "_positions", "_slopes")

    def __init__(self, positions: Sequence[float], corrections: Sequence[float]) -> None:
        ways = zip(positions[1:], positions[:-1], corrections[1:], corrections[:-1], strict=True)
        slopes = [(after - before) / (end - begin) for end, begin, after, before in ways]
        # One more place far below: a position before the first lies in a stretch of its own, without slope.
        self._positions = [-1e300, *positions]
        self._corrections = [corrections[0], *corrections]
        self._slopes = [0.0, *slopes, 0.0]

    def corrected(self, position: float) -> float:
        """Where an axis is whose encoder says `position`, m (rad)."""
        at = bisect_right(self._positions, position) - 1
        return position + (self._corrections[at] + self._slopes[at] * (position - self._positions[at]))

    def corrected_array(self, positions: Array) -> Array:
        """The same of many."""
        at = np.searchsorted(self._positions, positions, side="right") - 1
        begin, from_there = np.array(self._corrections)[at], positions - np.array(self._positions)[at]
        found: Array = positions + (begin + np.array(self._slopes)[at] * from_there)
        return found
