"""Trajectories made of quintic segments: hold, point to point, homing, and the injection plan.

A segment's numbers are all worked out when it is made, and on floats: a plan of thousands is begun within a tick.
"""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate
from typing import Final, NamedTuple

import numpy as np

from hil.control.laws.base import Array
from hil.control.trajectories.base import Times, Trajectory

NS: Final = 1e-9  # s
# Of a minimum-jerk move over d in T: times d/T, d/T^2 and d/T^3.
PEAK_SPEED: Final = 1.875
PEAK_ACCELERATION: Final = 10.0 / 3.0**0.5
PEAK_JERK: Final = 60.0
_NEVER: Final = 1 << 60  # ns

Values = Sequence[float]  # one per axis
# Of one axis, t in s from the segment's start: position c0 + c1 t + ... + c5 t^5, velocity c1 + v2 t + ... + v5 t^4,
# acceleration a2 + a3 t + ... + a5 t^3; in this order.
Row = tuple[float, float, float, float, float, float, float, float, float, float, float, float, float, float]


class Segment(NamedTuple):
    """A quintic per axis. rows: its coefficients, still: whether it does not move; both by axis."""

    duration_ns: int
    rows: list[Row]
    still: list[bool]
    phase: int


def quintic(duration_ns: int, begin: Sequence[Values], end: Sequence[Values], phase: int = 0) -> Segment:
    """The quintic that meets position, velocity and acceleration (m, m/s, m/s^2; each by axis) at both ends."""
    rows = [meeting_row(duration_ns * NS, *ends) for ends in zip(*begin, *end, strict=True)]
    return Segment(duration_ns, rows, [not any(row[1:6]) for row in rows], phase)


def meeting_row(t: float, p0: float, v0: float, a0: float, p1: float, v1: float, a1: float) -> Row:
    """One axis' quintic of t s (above 0) between two motions: position, velocity and acceleration, m, m/s, m/s^2."""
    d = p1 - p0 - v0 * t - 0.5 * a0 * (t * t)
    v = v1 - v0 - a0 * t
    a = a1 - a0
    t2 = t * t
    t3 = t2 * t
    c3 = (10.0 * d - 4.0 * v * t + 0.5 * a * t2) / t3
    c4 = (7.0 * v * t - 15.0 * d - a * t2) / (t3 * t)
    c5 = (6.0 * d - 3.0 * v * t + 0.5 * a * t2) / (t3 * t2)
    return _row(p0, v0, 0.5 * a0, c3, c4, c5)


def _row(c0: float, c1: float, c2: float, c3: float, c4: float, c5: float) -> Row:
    return c0, c1, c2, c3, c4, c5, 2.0 * c2, 3.0 * c3, 4.0 * c4, 5.0 * c5, 2.0 * c2, 6.0 * c3, 12.0 * c4, 20.0 * c5


def cubic_row(h: float, p0: float, v0: float, p1: float, v1: float) -> Row:
    """One axis' cubic of h s (above 0) between two positions and velocities, m and m/s."""
    slope = (p1 - p0) / h
    return _row(p0, v0, (3.0 * slope - 2.0 * v0 - v1) / h, (v0 + v1 - 2.0 * slope) / (h * h), 0.0, 0.0)


def segment(
    duration_ns: int, coefficients: Sequence[tuple[float, float, float, float, float, float]], phase: int
) -> Segment:
    """The segment with these coefficients c0 ... c5, by axis."""
    rows = [_row(c0, c1, c2, c3, c4, c5) for c0, c1, c2, c3, c4, c5 in coefficients]
    return Segment(duration_ns, rows, [not any(row[1:6]) for row in rows], phase)


def rest(duration_ns: int, position: Values, phase: int = 0) -> Segment:
    """Stand still."""
    rows = [_row(value, 0.0, 0.0, 0.0, 0.0, 0.0) for value in position]
    return Segment(duration_ns, rows, [True] * len(rows), phase)


def move(duration_ns: int, begin: Values, end: Values, phase: int = 0) -> Segment:
    """Minimum jerk from rest to rest."""
    zero = [0.0] * len(begin)
    return quintic(duration_ns, (begin, zero, zero), (end, zero, zero), phase)


class _Held:
    """One axis of a segment at hand: its row, as numbers of a compiled object's own, and whether it stands still."""

    __slots__ = ("row", "still")

    def __init__(self, row: Row, still: bool) -> None:
        self.row = row
        self.still = still


class _AtHand:
    """A segment with its place in the plan, ns of task time; axes: by axis."""

    __slots__ = ("axes", "begins", "ends")

    def __init__(self, segment: Segment, begins: int, ends: int) -> None:
        self.axes = [_Held(segment.rows[axis], still) for axis, still in enumerate(segment.still)]
        self.begins = begins
        self.ends = ends


class Segments(Trajectory):
    """Segments one after another; then over again, or for ever in the last one, which must be a rest of 0 ns.

    starts: where each begins, and where the last one ends, ns; None: to be worked out from their durations.
    """

    def __init__(
        self,
        segments: Sequence[Segment],
        *,
        repeat: bool,
        phase_names: tuple[str, ...],
        starts: list[int] | None = None,
    ) -> None:
        super().__init__(len(segments[0].rows))
        self.segments = segments
        if starts is None:
            starts = list(accumulate([segment.duration_ns for segment in segments], initial=0))
        self._starts = starts
        self._total = self._starts.pop()
        self._at_hand = self._spare = self._find(0)
        self._repeats = repeat
        self._arrays: dict[int, Array] = {}  # an axis' rows, (segments, 14): for who asks for many instants
        self.phase_names = phase_names
        self.repeat_ns = self._total if repeat else None
        self.duration_ns = None if repeat else self._total

    def phase_at(self, t_ns: int) -> int:
        """Phase of the segment that holds task time `t_ns`."""
        if self._repeats:
            t_ns %= self._total
        return self.segments[max(bisect_right(self._starts, t_ns) - 1, 0)].phase

    def _find(self, t_ns: int) -> _AtHand:
        index = bisect_right(self._starts, t_ns) - 1
        ends = self._starts[index + 1] if index + 1 < len(self._starts) else _NEVER
        return _AtHand(self.segments[index], self._starts[index], ends)

    def _turn_to(self, t_ns: int) -> _AtHand:
        """Have at hand the segment that holds task time `t_ns`: the next instant asked for is mostly there too.

        The one before it stays near: a tick at a border asks for either side by turns, axis after axis.
        """
        self._at_hand, self._spare = self._spare, self._at_hand
        if not self._at_hand.begins <= t_ns < self._at_hand.ends:
            self._at_hand = self._find(t_ns)
        return self._at_hand

    def at(self, axis: int, t_ns: int) -> tuple[float, float, float]:
        """See Trajectory."""
        t_ns = t_ns if t_ns > 0 else 0  # a third of what max() costs
        if self._repeats:
            t_ns %= self._total
        at_hand = self._at_hand
        if not at_hand.begins <= t_ns < at_hand.ends:
            at_hand = self._turn_to(t_ns)
        held = at_hand.axes[axis]
        c0, c1, c2, c3, c4, c5, v2, v3, v4, v5, a2, a3, a4, a5 = held.row
        if held.still:
            return c0, 0.0, 0.0
        t = (t_ns - at_hand.begins) * NS
        return (
            c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))),
            c1 + t * (v2 + t * (v3 + t * (v4 + t * v5))),
            a2 + t * (a3 + t * (a4 + t * a5)),
        )

    def _axis_array(self, axis: int, t_ns: Times) -> tuple[Array, Array, Array]:
        if axis not in self._arrays:
            self._arrays[axis] = np.array([segment.rows[axis] for segment in self.segments])
        if self._repeats:
            t_ns = t_ns % self._total
        starts = np.array(self._starts, dtype=np.int64)
        index = np.searchsorted(starts, t_ns, side="right") - 1
        c0, c1, c2, c3, c4, c5, v2, v3, v4, v5, a2, a3, a4, a5 = np.moveaxis(self._arrays[axis][index], -1, 0)
        t = (t_ns - starts[index]) * NS
        return (
            c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))),
            c1 + t * (v2 + t * (v3 + t * (v4 + t * v5))),
            a2 + t * (a3 + t * (a4 + t * a5)),
        )
