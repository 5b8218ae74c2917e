"""Paths through points: approached from wherever the stage rests, then followed as they were made beforehand.

Samples in time become a cubic spline with continuous acceleration, at rest at both ends; waypoints become minimum-jerk
moves from rest to rest, each as long as the limits on speed, acceleration and jerk demand (a quintic over d in T has
the peaks 15/8 d/T, 10/sqrt(3) d/T^2 and 60 d/T^3).
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from hil.control.laws.base import Array
from hil.control.trajectories.base import Times, Trajectory
from hil.control.trajectories.minimum_jerk import minimum_jerk
from hil.control.trajectories.segments import Segment, Segments, cubic, move, rest
from sim_plant.physics.exact_trigonometry import sincos_turns

PEAK_SPEED: Final = 1.875
PEAK_ACCELERATION: Final = 10.0 / 3.0**0.5
PEAK_JERK: Final = 60.0
PER_TURN: Final = 64  # samples of a spiral
APPROACH, PATH = 0, 1


class Path(Trajectory):
    """`body` from its first point on, after a minimum-jerk approach to it; axes without a column in it stay at rest.

    columns: of every axis, its place in the body, or -1.
    """

    phase_names: tuple[str, ...] = ("approach", "path")

    def __init__(
        self, body: Segments, columns: Sequence[int], start: Sequence[float], approach_ns: int, settle_ns: int
    ) -> None:
        super().__init__(len(start))
        self._body, self._columns, self._start = body, list(columns), list(start)
        self._approach_ns = approach_ns
        there = [body.at(column, 0)[0] if column >= 0 else start[axis] for axis, column in enumerate(columns)]
        self._approach = Segments(
            [move(approach_ns, start, there), rest(0, there)], repeat=False, phase_names=("approach",)
        )
        self.repeat_ns = body.repeat_ns
        self.repeat_from_ns = approach_ns
        self.duration_ns = None if body.duration_ns is None else approach_ns + body.duration_ns
        self.steady_from_ns = approach_ns + settle_ns

    def phase_at(self, t_ns: int) -> int:
        """Approach, then path."""
        return APPROACH if t_ns < self._approach_ns else PATH

    def at(self, axis: int, t_ns: int) -> tuple[float, float, float]:
        """See Trajectory."""
        column = self._columns[axis]
        if column < 0:
            return self._start[axis], 0.0, 0.0
        if t_ns < self._approach_ns:
            return self._approach.at(axis, t_ns)
        return self._body.at(column, t_ns - self._approach_ns)

    def _axis_array(self, axis: int, t_ns: Times) -> tuple[Array, Array, Array]:
        column = self._columns[axis]
        if column < 0:
            zero = np.zeros(t_ns.shape)
            return np.full(t_ns.shape, self._start[axis]), zero, zero
        before = self._approach._axis_array(axis, t_ns)
        after = self._body._axis_array(column, np.maximum(t_ns - self._approach_ns, 0))
        early = t_ns < self._approach_ns
        return (
            np.where(early, before[0], after[0]),
            np.where(early, before[1], after[1]),
            np.where(early, before[2], after[2]),
        )


def spline(rows: Sequence[Sequence[float]], *, repeat: bool) -> Segments:
    """The cubic spline through rows of time (s, increasing) and positions (m, one a column), at rest at both ends."""
    times = [round((row[0] - rows[0][0]) * 1e9) for row in rows]
    lengths = [after - before for before, after in pairwise(times)]
    columns = [[row[column] for row in rows] for column in range(1, len(rows[0]))]
    speeds = [_spline_speeds(column, lengths) for column in columns]
    parts = []
    for index, length in enumerate(lengths):
        ends = [
            (column[index], speed[index], column[index + 1], speed[index + 1])
            for column, speed in zip(columns, speeds, strict=True)
        ]
        parts.append(cubic(length, ends))
    return _body(parts, [column[-1] for column in columns], repeat=repeat)


def _spline_speeds(q: Sequence[float], lengths_ns: Sequence[int]) -> list[float]:
    """Speeds at the points that make the acceleration continuous, 0 at both ends: a tridiagonal system, solved from the
    first row to the last and back (Thomas), so that every machine computes the same bits.
    """
    inverse = [1e9 / length for length in lengths_ns]
    slopes = [(q[i + 1] - q[i]) * inverse[i] for i in range(len(inverse))]
    upper, right = [0.0], [0.0]
    for i in range(1, len(inverse)):
        pivot = 2.0 * (inverse[i - 1] + inverse[i]) - inverse[i - 1] * upper[i - 1]
        upper.append(inverse[i] / pivot)
        known = 3.0 * (slopes[i - 1] * inverse[i - 1] + slopes[i] * inverse[i])
        right.append((known - inverse[i - 1] * right[i - 1]) / pivot)
    speeds = [0.0] * len(q)
    for i in range(len(inverse) - 1, 0, -1):
        speeds[i] = right[i] - upper[i] * speeds[i + 1]
    return speeds


def waypoints(
    points: Sequence[Sequence[float]], limits: tuple[float, float, float], ns: Callable[[float], int], dwell_ns: int,
    *, repeat: bool,
) -> Segments:  # fmt: skip
    """Moves from rest to rest through points (m, one a column) within (speed, acceleration, jerk) along every axis.

    ns: seconds as ns, up to whole periods. Points that repeat end where they begin.
    """
    speed, acceleration, jerk = limits
    through = [*points, points[0]] if repeat and list(points[-1]) != list(points[0]) else list(points)
    parts: list[Segment] = []
    for before, after in pairwise(through):
        distance = max([abs(b - a) for a, b in zip(before, after, strict=True)])
        if distance > 0.0:
            by_speed = PEAK_SPEED * distance / speed
            by_acceleration = (PEAK_ACCELERATION * distance / acceleration) ** 0.5
            by_jerk = (PEAK_JERK * distance / jerk) ** (1.0 / 3.0)
            parts.append(move(ns(max(by_speed, by_acceleration, by_jerk)), before, after))
        if dwell_ns:
            parts.append(rest(dwell_ns, after))
    return _body(parts, through[-1], repeat=repeat)


def spiral_samples(radius: float, turns: float, seconds: float) -> list[list[float]]:
    """Rows of an Archimedean spiral from its centre outwards, radius and angle minimum jerk over `seconds`."""
    count = max(round(PER_TURN * turns), 2)
    rows = []
    for k in range(count + 1):
        s = minimum_jerk(k / count)[0]
        sine, cosine = sincos_turns(turns * s)
        rows.append([seconds * k / count, radius * s * cosine, radius * s * sine])
    return rows


def _body(parts: list[Segment], last: Sequence[float], *, repeat: bool) -> Segments:
    ending = [] if repeat and parts else [rest(0, last)]
    return Segments([*parts, *ending], repeat=repeat and bool(parts), phase_names=("path",))
