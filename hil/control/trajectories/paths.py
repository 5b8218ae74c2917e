"""Paths through points: approached from wherever the stage rests, then followed as they were made beforehand.

Samples in time become a cubic spline with continuous acceleration; its first and last pieces are quintics, so that it
begins and ends at rest without a jump of the acceleration. Waypoints become minimum-jerk moves from rest to rest, lines
with rounded corners (blends.py), or a spline through them whose time is scaled: each as quick as the limits on speed,
acceleration and jerk of every axis allow.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from hil.control.laws.base import Array
from hil.control.trajectories.base import Times, Trajectory
from hil.control.trajectories.blends import Limits, blended, rest_to_rest
from hil.control.trajectories.minimum_jerk import minimum_jerk
from hil.control.trajectories.segments import Segment, Segments, cubic, move, quintic, rest
from sim_plant.physics.exact_trigonometry import sincos_turns

PER_TURN: Final = 64  # samples of a spiral
UNSCALED_S: Final = 1000.0  # duration of a spline through waypoints, before its time is scaled
LOOKS: Final = 32  # instants of a piece at which its peaks are looked for
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


class AlongPath:
    """The Plan of a path: `body`, made beforehand, behind an approach from wherever the stage rests."""

    def __init__(self, body: Segments, columns: Sequence[int], approach_ns: int, settle_ns: int) -> None:
        self.body, self.columns = body, list(columns)
        self.approach_ns, self.settle_ns = approach_ns, settle_ns

    def __call__(self, start: Sequence[float]) -> Trajectory:
        """The trajectory from rest at `start`, m by axis."""
        return Path(self.body, self.columns, start, self.approach_ns, self.settle_ns)


def spline(rows: Sequence[Sequence[float]], *, repeat: bool, dwell_ns: int = 0) -> Segments:
    """The cubic spline through rows of time (s, increasing) and positions (m, one a column), at rest at both ends; then
    a rest of dwell_ns.
    """
    times = [round((row[0] - rows[0][0]) * 1e9) for row in rows]
    lengths = [after - before for before, after in pairwise(times)]
    columns = [[row[column] for row in rows] for column in range(1, len(rows[0]))]
    speeds = [_spline_speeds(column, lengths) for column in columns]
    parts = []
    for index, length in enumerate(lengths):
        if 0 < index < len(lengths) - 1:
            pairs = zip(columns, speeds, strict=True)
            parts.append(cubic(length, [(q[index], v[index], q[index + 1], v[index + 1]) for q, v in pairs]))
        else:
            begin, end = [_motion(columns, speeds, lengths, place) for place in (index, index + 1)]
            parts.append(quintic(length, begin, end))
    last = [column[-1] for column in columns]
    if dwell_ns:
        parts.append(rest(dwell_ns, last))
    return _body(parts, last, repeat=repeat)


def _motion(
    columns: list[list[float]], speeds: list[list[float]], lengths_ns: list[int], place: int
) -> tuple[list[float], list[float], list[float]]:
    """Position, speed and acceleration of every column at one of the spline's points; at rest at either end."""
    accelerations = [0.0] * len(columns)
    if 0 < place < len(lengths_ns):
        h = lengths_ns[place] * 1e-9
        for column, (q, v) in enumerate(zip(columns, speeds, strict=True)):
            accelerations[column] = (6.0 * (q[place + 1] - q[place]) / h - 4.0 * v[place] - 2.0 * v[place + 1]) / h
    return [q[place] for q in columns], [v[place] for v in speeds], accelerations


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


def fitted_spline(
    points: Sequence[Sequence[float]], limits: Limits, ns: Callable[[float], int], dwell_ns: int, *, repeat: bool
) -> Segments:
    """A spline through points (m, one a column; none twice in a row) without stopping, as quick as the limits of every
    axis allow; then a rest of dwell_ns. Points that repeat end where they begin.

    Its time is the centripetal one (Lee, Computer-Aided Design 21(6), 1989), scaled as a whole. ns: as for `waypoints`.
    """
    through = _closed(points) if repeat else list(points)
    times = [0.0]
    for before, after in pairwise(through):
        times.append(times[-1] + math.sqrt(math.dist(before, after)))
    shares = [time / times[-1] for time in times]
    peaks = _peaks(spline([[UNSCALED_S * s, *q] for s, q in zip(shares, through, strict=True)], repeat=False))
    speed, acceleration, jerk = [peak / limit for peak, limit in zip(peaks, limits, strict=True)]
    seconds = ns(UNSCALED_S * max(speed, acceleration**0.5, jerk ** (1.0 / 3.0))) * 1e-9
    rows = [[seconds * s, *q] for s, q in zip(shares, through, strict=True)]
    return spline(rows, repeat=repeat, dwell_ns=dwell_ns)


def _peaks(body: Segments) -> tuple[float, float, float]:
    """The greatest speed, acceleration and jerk of any column, or a little more: the jerk of a quintic is a parabola,
    and what changes by at most so much cannot exceed by more what was seen nearby.
    """
    rows = np.array([segment.rows for segment in body.segments if segment.duration_ns])
    h = np.array([segment.duration_ns * 1e-9 for segment in body.segments if segment.duration_ns])[:, None, None]
    _, c1, _, _, _, _, v2, v3, v4, v5, a2, a3, a4, a5 = np.moveaxis(rows[..., None], 2, 0)
    t = h * (np.arange(LOOKS + 1) / LOOKS)
    vertex = np.clip(np.divide(-a4, 3.0 * a5, out=np.zeros_like(a4), where=a5 != 0.0), 0.0, h)
    jerk = [np.abs(a3 + at * (2.0 * a4 + 3.0 * at * a5)).max(axis=-1) for at in (t[..., [0]], t[..., [-1]], vertex)]
    most = np.maximum(np.maximum(jerk[0], jerk[1]), jerk[2])
    step = h[..., 0] / LOOKS
    acceleration = np.abs(a2 + t * (a3 + t * (a4 + t * a5))).max(axis=-1) + 0.5 * step * most
    speed = np.abs(c1 + t * (v2 + t * (v3 + t * (v4 + t * v5)))).max(axis=-1) + step * step * most / 8.0
    return float(speed.max()), float(acceleration.max()), float(most.max())


def _closed(points: Sequence[Sequence[float]]) -> list[Sequence[float]]:
    return [*points, points[0]] if list(points[-1]) != list(points[0]) else list(points)


def raster_points(corner: Sequence[float], size: Sequence[float], lines: int) -> list[list[float]]:
    """The ends of `lines` parallel lines (at least 2), to and fro: along the first column, one beside the other along
    the second.
    """
    points = []
    for k in range(lines):
        across = corner[1] + size[1] * k / (lines - 1)
        ends = [[corner[0], across], [corner[0] + size[0], across]]
        points += ends[::-1] if k % 2 else ends
    return points


def waypoints(
    points: Sequence[Sequence[float]], limits: Limits, ns: Callable[[float], int], dwell_ns: int, blend: float, *,
    repeat: bool,
) -> Segments:  # fmt: skip
    """Through points (m, one a column) within (speed, acceleration, jerk) along every axis: from rest to rest, with a
    rest of dwell_ns at each, or where `blend` (m) is above 0 past them at no more than that, with a rest at the end.

    ns: seconds as ns, up to whole periods. Points that repeat end where they begin.
    """
    through = _closed(points) if repeat else list(points)
    if blend > 0.0:
        apart = [through[0], *(after for before, after in pairwise(through) if list(before) != list(after))]
        around = blended(apart, limits, blend, ns) if len(apart) > 1 else []
        return _body([*around, *([rest(dwell_ns, through[-1])] if dwell_ns else [])], through[-1], repeat=repeat)
    parts: list[Segment] = []
    for before, after in pairwise(through):
        distance = max([abs(b - a) for a, b in zip(before, after, strict=True)])
        if distance > 0.0:
            parts.append(move(ns(rest_to_rest(distance, limits)), before, after))
        if dwell_ns:
            parts.append(rest(dwell_ns, after))
    return _body(parts, through[-1], repeat=repeat)


def spiral_samples(radius: float, turns: float, seconds: float, *, back: bool) -> list[list[float]]:
    """Rows of an Archimedean spiral from its centre outwards, radius and angle minimum jerk over `seconds`; then as
    long for the same way back.
    """
    count = max(round(PER_TURN * turns), 2)
    rows = []
    for k in range(count + 1):
        s = minimum_jerk(k / count)[0]
        sine, cosine = sincos_turns(turns * s)
        rows.append([seconds * k / count, radius * s * cosine, radius * s * sine])
    if back:
        rows += [[2.0 * seconds - row[0], *row[1:]] for row in rows[-2::-1]]
    return rows


def _body(parts: list[Segment], last: Sequence[float], *, repeat: bool) -> Segments:
    ending = [] if repeat and parts else [rest(0, last)]
    return Segments([*parts, *ending], repeat=repeat and bool(parts), phase_names=("path",))
