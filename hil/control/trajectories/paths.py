"""Paths through points: approached from wherever the stage rests, then followed as they were made beforehand.

Samples in time are gone through as rows.py says. Waypoints become lines from rest to rest or with rounded corners
(blends.py), or a spline through them whose time is scaled. Each is as quick as the limits on speed, acceleration and
jerk of every axis allow. Points that are nearer to each other than an encoder count, in every axis, are one point.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from hil.control.laws.base import Array
from hil.control.trajectories.base import Times, Trajectory
from hil.control.trajectories.blends import Limits, lines
from hil.control.trajectories.minimum_jerk import entered, minimum_jerk
from hil.control.trajectories.rows import along_rows
from hil.control.trajectories.segments import Segment, Segments, move, rest
from sim_plant.physics.exact_trigonometry import sincos_turns

PER_TURN: Final = 64  # samples of a spiral
UNSCALED_S: Final = 1000.0  # duration of a spline through waypoints, before its time is scaled
LOOKS: Final = 32  # instants of a piece at which its peaks are looked for
APPROACH, PATH = 0, 1


class Path(Trajectory):
    """`body` from its first point on, after a minimum-jerk approach to it; axes without a column in it stay at rest. A
    body that repeats without a rest is blended in, as if it had gone on before.

    columns: of every axis, its place in the body, or -1.
    """

    phase_names: tuple[str, ...] = ("approach", "path")

    def __init__(
        self, body: Segments, columns: Sequence[int], start: Sequence[float], approach_ns: int, settle_ns: int
    ) -> None:
        super().__init__(len(start))
        self._body, self._columns, self._start = body, list(columns), list(start)
        self._approach_ns = approach_ns
        self._per_second = 1e9 / approach_ns
        moves = [any(body.at(column, 0)[1:]) for column in columns if column >= 0]
        around = body.repeat_ns or 1
        self._ahead_ns = around - approach_ns % around if body.repeat_ns and any(moves) else -1  # of the body, at 0
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
            if self._ahead_ns < 0:
                return self._approach.at(axis, t_ns)
            t_ns = t_ns if t_ns > 0 else 0
            motion: tuple[float, float, float] = entered(
                self._start[axis],
                self._body.at(column, t_ns + self._ahead_ns),
                t_ns / self._approach_ns,
                self._per_second,
            )
            return motion
        return self._body.at(column, t_ns - self._approach_ns)

    def _axis_array(self, axis: int, t_ns: Times) -> tuple[Array, Array, Array]:
        column = self._columns[axis]
        if column < 0:
            zero = np.zeros(t_ns.shape)
            return np.full(t_ns.shape, self._start[axis]), zero, zero
        if self._ahead_ns < 0:
            before = self._approach._axis_array(axis, t_ns)
        else:
            u = np.minimum(t_ns, self._approach_ns) / self._approach_ns
            motion = self._body._axis_array(column, t_ns + self._ahead_ns)
            before = entered(self._start[axis], motion, u, self._per_second)
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


def fitted_spline(
    points: Sequence[Sequence[float]], limits: Limits, ns: Callable[[float], int], dwell_ns: int, *, repeat: bool
) -> Segments:
    """A spline through points (m, one a column; none twice in a row) without stopping, as quick as the limits of every
    axis allow; then a rest of dwell_ns. Points that repeat end where they begin.

    Its time is the centripetal one (Lee, Computer-Aided Design 21(6), 1989), scaled as a whole. ns: as for `waypoints`.
    """
    times = [0.0]
    for before, after in pairwise(points):
        times.append(times[-1] + math.sqrt(math.dist(before, after)))
    shares = [time / times[-1] for time in times]
    around = repeat and not dwell_ns
    unscaled = [[UNSCALED_S * s, *q] for s, q in zip(shares, points, strict=True)]
    peaks = _peaks(along_rows(unscaled, repeat=around))
    speed, acceleration, jerk = [peak / limit for peak, limit in zip(peaks, limits, strict=True)]
    seconds = ns(UNSCALED_S * max(speed, acceleration**0.5, jerk ** (1.0 / 3.0))) * 1e-9
    rows = [[seconds * s, *q] for s, q in zip(shares, points, strict=True)]
    return along_rows(rows, repeat=repeat, dwell_ns=dwell_ns)


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


def apart(points: Sequence[Sequence[float]], counts: Sequence[float], *, repeat: bool) -> list[list[float]]:
    """Points that lie further from the one before than `counts`, m by column, in some column; of what repeats the last
    is the first, whether that was said or not.
    """
    kept = [list(points[0])]
    for point in points[1:]:
        if _differ(kept[-1], point, counts):
            kept.append(list(point))
    if repeat and len(kept) > 1:
        if not _differ(kept[-1], kept[0], counts):
            kept.pop()
        kept.append(list(kept[0]))
    return kept


def _differ(before: Sequence[float], after: Sequence[float], counts: Sequence[float]) -> bool:
    return any(abs(b - a) > count for a, b, count in zip(before, after, counts, strict=True))


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
    """Through points (m, one a column; none twice in a row) within (speed, acceleration, jerk) along every axis, from
    rest to rest, with a rest of dwell_ns at each. Where `blend` (m) is above 0 past them at no more than that, with a
    rest at the end.

    ns: seconds as ns, up to whole periods. Points that repeat end where they begin.
    """
    parts: list[Segment] = []
    stops = [points] if blend > 0.0 else pairwise(points)
    for stretch in stops:
        if len(stretch) > 1:
            parts += lines(stretch, limits, blend, ns)
        if dwell_ns:
            parts.append(rest(dwell_ns, stretch[-1]))
    ending = [] if repeat and parts else [rest(0, points[-1])]
    return Segments([*parts, *ending], repeat=repeat and bool(parts), phase_names=("path",))


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
