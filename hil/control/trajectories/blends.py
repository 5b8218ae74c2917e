"""Straight lines from rest to rest, and waypoints passed without stopping, at corners rounded within a stated distance.

A corner is left and entered at the same speed. The velocity turns from one direction to the other by the smooth step 3
u^2 - 2 u^3. So it begins and ends b from the point where it lasts 2 b / v. Its peaks are 1.5 v D / T of acceleration
and 6 v D / T^2 of jerk (D: change of the direction). A line joins its ends' speeds by the same step, and adds a
minimum-jerk move for what is left of the way. Acceleration is zero at every border.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from hil.control.plans.axis_plan import AxisPlan, MotionLimits, Piece
from hil.control.plans.ramps import Ramp
from hil.control.trajectories.segments import Segment, Values, quintic, segment

STEP_ACCELERATION: Final = 1.5  # peaks of the smooth step
STEP_JERK: Final = 6.0
SHARE: Final = 0.4  # of a line, at most, that either corner takes
HALVINGS: Final = 60

Limits = tuple[float, float, float]  # speed, acceleration, jerk


class _Line(NamedTuple):
    """direction: a unit vector. length: m. limits: along it."""

    direction: list[float]
    length: float
    limits: Limits


def lines(points: Sequence[Values], limits: Limits, blend: float, ns: Callable[[float], int]) -> list[Segment]:
    """From rest to rest through points (m, one a column; at least two, none twice in a row) within `limits` of every
    axis, passing each within `blend` (m). Where that is 0, or would take longer, it goes from rest to rest in each.

    ns: seconds as ns, up to whole periods; all of it lasts whole periods, every corner at least one.
    """
    rests = [part for pair in pairwise(points) for part in _through(pair, limits, 0.0, ns)]
    if blend <= 0.0 or len(points) == 2:
        return rests
    passed = _through(points, limits, blend, ns)
    return passed if _duration(passed) <= _duration(rests) else rests


def _duration(parts: Sequence[Segment]) -> int:
    return sum([part.duration_ns for part in parts])


def _through(points: Sequence[Values], limits: Limits, blend: float, ns: Callable[[float], int]) -> list[Segment]:
    found = [_line(before, after, limits) for before, after in pairwise(points)]
    cuts = [0.0, *(min(blend, SHARE * a.length, SHARE * b.length) for a, b in pairwise(found)), 0.0]
    free = [line.length - cuts[i] - cuts[i + 1] for i, line in enumerate(found)]
    speeds = _speeds(found, cuts, free, limits, ns(0.0) * 1e-9)
    courses = [_course(speeds[i], speeds[i + 1], free[i], line.limits) for i, line in enumerate(found)]
    corners = [2.0 * cuts[i] / speeds[i] if speeds[i] else 0.0 for i in range(1, len(found))]
    total = math.fsum([*corners, *[course.ends for course in courses]])
    whole = ns(total)
    clock = _Clock(whole * 1e-9 / total)  # at least 1, but for rounding
    parts: list[Segment] = []
    for i, line in enumerate(found):
        if i:
            before = _passing(points[i], -cuts[i], found[i - 1], speeds[i] / clock.slower)
            after = _passing(points[i], cuts[i], line, speeds[i] / clock.slower)
            if length := clock.go(corners[i - 1]):
                parts.append(quintic(length, before, after))
        begin = [q + cuts[i] * u for q, u in zip(points[i], line.direction, strict=True)]
        for piece in courses[i].pieces:
            late = clock.late
            if length := clock.go(piece.ends - piece.begins):
                parts.append(_piece(length, piece, begin, line.direction, clock.slower, late))
    last = parts[-1]
    parts[-1] = Segment(last.duration_ns + whole - clock.now_ns, last.rows, last.still, last.phase)
    return parts


class _Clock:
    """Durations one after another, in `slower` times the s that they state, rounded to ns without adding up. late: s by
    which the rounded clock is ahead of the exact one.
    """

    def __init__(self, slower: float) -> None:
        self.slower = slower
        self.now_ns = 0
        self.late = 0.0
        self._exact = 0.0

    def go(self, seconds: float) -> int:
        """The ns that they take here."""
        self._exact += seconds * self.slower
        before, self.now_ns = self.now_ns, round(self._exact * 1e9)
        self.late = self.now_ns * 1e-9 - self._exact
        return self.now_ns - before


def _passing(point: Values, away: float, line: _Line, speed: float) -> tuple[list[float], list[float], list[float]]:
    place = [q + away * u for q, u in zip(point, line.direction, strict=True)]
    return place, [speed * u for u in line.direction], [0.0] * len(place)


def _piece(
    length: int, piece: Piece, begin: Sequence[float], direction: Sequence[float], slower: float, late: float
) -> Segment:
    """A piece along a line, from `late` s after its exact beginning on: its jerk stays what it is, however short."""
    s2 = slower * slower
    c1, c2, c3 = piece.c1 / slower, piece.c2 / s2, piece.c3 / (s2 * slower)
    d0 = piece.c0 + late * (c1 + late * (c2 + late * c3))
    d1 = c1 + late * (2.0 * c2 + late * (3.0 * c3))
    d2 = c2 + 3.0 * late * c3
    rows = [(q + d0 * u, d1 * u, d2 * u, c3 * u, 0.0, 0.0) for q, u in zip(begin, direction, strict=True)]
    return segment(length, rows, 0)


def _course(begin: float, end: float, length: float, limits: Limits) -> AxisPlan:
    """Along a line between two speeds that a ramp can join, as quickly as can be; m and m/s along it."""
    held = MotionLimits(*limits, 0.0, length)
    low, high = max(begin, end), limits[0]
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if Ramp(begin, 0.0, middle, held).way + Ramp(middle, 0.0, end, held).way <= length:
            low = middle
        else:
            high = middle
    first, last = Ramp(begin, 0.0, low, held), Ramp(low, 0.0, end, held)
    plan = AxisPlan(0.0, begin, 0.0)
    first.append(plan, low)
    plan.push(0.0, (length - first.way - last.way) / low)
    last.append(plan, end)
    return plan


def _line(before: Values, after: Values, limits: Limits) -> _Line:
    way = [b - a for a, b in zip(before, after, strict=True)]
    largest = max([abs(value) for value in way])
    length = largest * math.sqrt(math.fsum([(value / largest) * (value / largest) for value in way]))
    share = largest / length  # of the axis that moves most
    return _Line([value / length for value in way], length, _scaled(limits, share))


def _scaled(limits: Limits, share: float) -> Limits:
    return limits[0] / share, limits[1] / share, limits[2] / share


def _speeds(found: list[_Line], cuts: list[float], free: list[float], limits: Limits, period: float) -> list[float]:
    """Speed at every point: what its corner allows, and what the lines can reach from either end."""
    speeds = [0.0]
    for i, (a, b) in enumerate(pairwise(found), 1):
        allowed = min(a.limits[0], b.limits[0], 2.0 * cuts[i] / period)
        turn = max([abs(q - p) for p, q in zip(a.direction, b.direction, strict=True)])
        if turn > 0.0:
            by_acceleration = math.sqrt(2.0 * cuts[i] * limits[1] / (STEP_ACCELERATION * turn))
            by_jerk = (4.0 * cuts[i] * cuts[i] * limits[2] / (STEP_JERK * turn)) ** (1.0 / 3.0)
            allowed = min(allowed, by_acceleration, by_jerk)
        speeds.append(allowed)
    speeds.append(0.0)
    for i, line in enumerate(found):
        speeds[i + 1] = min(speeds[i + 1], _reach(speeds[i], free[i], line.limits))
    for i in range(len(found) - 1, -1, -1):
        speeds[i] = min(speeds[i], _reach(speeds[i + 1], free[i], found[i].limits))
    return speeds


def _reach(speed: float, length: float, limits: Limits) -> float:
    """The greatest speed that a ramp reaches along a line."""
    held = MotionLimits(*limits, 0.0, length)
    low, high = speed, max(speed, limits[0])
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if Ramp(speed, 0.0, middle, held).way <= length:
            low = middle
        else:
            high = middle
    return low
