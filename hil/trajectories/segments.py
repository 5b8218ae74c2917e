"""Trajectories made of quintic segments: hold, point to point, and the injection plan."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.laws.base import Array
from hil.trajectories.base import Times, Trajectory

NS = 1e-9  # s


@dataclass(frozen=True)
class Segment:
    """A quintic in (t - its start), per axis: `coefficients` (6, n_axes), lowest power first, t in s."""

    duration_ns: int
    coefficients: Array
    phase: int = 0


def quintic(duration_ns: int, begin: Sequence[Array], end: Sequence[Array], phase: int = 0) -> Segment:
    """The quintic that meets position, velocity and acceleration, each (n_axes,), at both ends."""
    t = duration_ns * NS
    (p0, v0, a0), (p1, v1, a1) = begin, end
    d = p1 - p0 - v0 * t - 0.5 * a0 * (t * t)
    v = v1 - v0 - a0 * t
    a = a1 - a0
    t2 = t * t
    t3 = t2 * t
    c3 = (10.0 * d - 4.0 * v * t + 0.5 * a * t2) / t3
    c4 = (7.0 * v * t - 15.0 * d - a * t2) / (t3 * t)
    c5 = (6.0 * d - 3.0 * v * t + 0.5 * a * t2) / (t3 * t2)
    return Segment(duration_ns, np.stack([p0, v0, 0.5 * a0, c3, c4, c5]), phase)


def rest(duration_ns: int, position: Array, phase: int = 0) -> Segment:
    """Stand still."""
    coefficients = np.zeros((6, len(position)))
    coefficients[0] = position
    return Segment(duration_ns, coefficients, phase)


def move(duration_ns: int, begin: Array, end: Array, phase: int = 0) -> Segment:
    """Minimum jerk from rest to rest."""
    zero = np.zeros(len(begin))
    return quintic(duration_ns, (begin, zero, zero), (end, zero, zero), phase)


class Segments(Trajectory):
    """Quintic segments one after another; then either over again or standing still at `final`."""

    def __init__(
        self, segments: Sequence[Segment], *, final: Array, repeat: bool, phase_names: tuple[str, ...]
    ) -> None:
        super().__init__(len(final))
        durations = [segment.duration_ns for segment in segments]
        self._total = sum(durations)
        self._starts = [sum(durations[:i]) for i in range(len(segments))]
        tables = [segment.coefficients for segment in segments]
        if not repeat:
            self._starts.append(self._total)
            tables.append(rest(0, final).coefficients)
        self._starts_array = np.array(self._starts, dtype=np.int64)
        self._table = np.stack(tables)  # (segments, 6, n_axes)
        c2, c3, c4, c5 = (self._table[:, power] for power in range(2, 6))
        derived = [2.0 * c2, 3.0 * c3, 4.0 * c4, 5.0 * c5, 2.0 * c2, 6.0 * c3, 12.0 * c4, 20.0 * c5]
        whole = np.concatenate([self._table, np.stack(derived, axis=1)], axis=1)
        # [axis][segment]: coefficients of position, then those of velocity and acceleration that follow from them
        self._lists: list[list[list[float]]] = whole.transpose(2, 0, 1).tolist()
        self._still: list[list[bool]] = (self._table[:, 1:] == 0.0).all(axis=1).T.tolist()  # [axis][segment]
        self._phases = [segment.phase for segment in segments] + [len(phase_names) - 1] * (not repeat)
        self._repeats = repeat
        self.phase_names = phase_names
        self.repeat_ns = self._total if repeat else None
        self.duration_ns = None if repeat else self._total

    def phase_at(self, t_ns: int) -> int:
        """Phase of the segment that holds task time `t_ns`."""
        if self._repeats:
            t_ns %= self._total
        return self._phases[max(bisect_right(self._starts, t_ns) - 1, 0)]

    def at(self, axis: int, t_ns: int) -> tuple[float, float, float]:
        """See Trajectory."""
        t_ns = t_ns if t_ns > 0 else 0  # a third of what max() costs
        if self._repeats:
            t_ns %= self._total
        index = bisect_right(self._starts, t_ns) - 1
        c0, c1, c2, c3, c4, c5, v2, v3, v4, v5, a2, a3, a4, a5 = self._lists[axis][index]
        if self._still[axis][index]:
            return c0, 0.0, 0.0
        t = (t_ns - self._starts[index]) * NS
        return (
            c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))),
            c1 + t * (v2 + t * (v3 + t * (v4 + t * v5))),
            a2 + t * (a3 + t * (a4 + t * a5)),
        )

    def _axis_array(self, axis: int, t_ns: Times) -> tuple[Array, Array, Array]:
        if self._repeats:
            t_ns = t_ns % self._total
        index = np.searchsorted(self._starts_array, t_ns, side="right") - 1
        c0, c1, c2, c3, c4, c5 = np.moveaxis(self._table[index, :, axis], -1, 0)
        t = (t_ns - self._starts_array[index]) * NS
        return (
            c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))),
            c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * (5.0 * c5)))),
            2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * (20.0 * c5))),
        )
