"""Waypoints passed without stopping: straight lines, and corners rounded within a stated distance of their point.

A corner is left and entered at the same speed: the velocity turns from one direction to the other by the smooth step
3 u^2 - 2 u^3, so that it begins and ends b from the point where it lasts 2 b / v, with the peaks 1.5 v D / T of
acceleration and 6 v D / T^2 of jerk (D: change of the direction). A line joins its ends' speeds by the same step, and
adds a minimum-jerk move for what is left of the way. Acceleration is zero at every border.
"""

import math
from collections.abc import Callable, Sequence
from itertools import accumulate, pairwise
from typing import Final, NamedTuple

from hil.control.trajectories.segments import PEAK_ACCELERATION, PEAK_JERK, PEAK_SPEED, Segment, Values, quintic

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


def blended(points: Sequence[Values], limits: Limits, blend: float, ns: Callable[[float], int]) -> list[Segment]:
    """From rest to rest through points (m, one a column; at least two, none twice in a row) within `limits` of every
    axis, passing each within `blend` (m, above 0) of it.

    ns: seconds as ns, up to whole periods; all of it lasts whole periods, every corner at least one.
    """
    lines = [_line(before, after, limits) for before, after in pairwise(points)]
    cuts = [0.0, *(min(blend, SHARE * a.length, SHARE * b.length) for a, b in pairwise(lines)), 0.0]
    free = [line.length - cuts[i] - cuts[i + 1] for i, line in enumerate(lines)]
    speeds = _speeds(lines, cuts, free, limits, ns(0.0) * 1e-9)
    times: list[float] = []
    for i, line in enumerate(lines):
        if i:
            times.append(2.0 * cuts[i] / speeds[i])
        times.append(_line_time(speeds[i], speeds[i + 1], free[i], line.limits))
    total = math.fsum(times)
    whole = ns(total)
    slower = whole * 1e-9 / total  # at least 1, but for rounding
    ends = [round(end * slower * 1e9) for end in accumulate(times)]
    ends[-1] = whole
    return _segments(points, lines, cuts, [speed / slower for speed in speeds], [0, *ends])


def _line(before: Values, after: Values, limits: Limits) -> _Line:
    way = [b - a for a, b in zip(before, after, strict=True)]
    largest = max([abs(value) for value in way])
    length = largest * math.sqrt(math.fsum([(value / largest) * (value / largest) for value in way]))
    share = largest / length  # of the axis that moves most
    return _Line([value / length for value in way], length, _scaled(limits, share))


def _scaled(limits: Limits, share: float) -> Limits:
    return limits[0] / share, limits[1] / share, limits[2] / share


def _speeds(lines: list[_Line], cuts: list[float], free: list[float], limits: Limits, period: float) -> list[float]:
    """Speed at every point: what its corner allows, and what the lines can reach from either end."""
    speeds = [0.0]
    for i, (a, b) in enumerate(pairwise(lines), 1):
        allowed = min(a.limits[0], b.limits[0], 2.0 * cuts[i] / period)
        turn = max([abs(q - p) for p, q in zip(a.direction, b.direction, strict=True)])
        if turn > 0.0:
            by_acceleration = math.sqrt(2.0 * cuts[i] * limits[1] / (STEP_ACCELERATION * turn))
            by_jerk = (4.0 * cuts[i] * cuts[i] * limits[2] / (STEP_JERK * turn)) ** (1.0 / 3.0)
            allowed = min(allowed, by_acceleration, by_jerk)
        speeds.append(allowed)
    speeds.append(0.0)
    for i, line in enumerate(lines):
        speeds[i + 1] = min(speeds[i + 1], _reach(speeds[i], free[i], line.limits))
    for i in range(len(lines) - 1, -1, -1):
        speeds[i] = min(speeds[i], _reach(speeds[i + 1], free[i], lines[i].limits))
    return speeds


def _reach(speed: float, length: float, limits: Limits) -> float:
    """The greatest speed that the smooth step alone reaches along a line."""
    _, acceleration, jerk = limits
    low, high = speed, math.sqrt(speed * speed + 2.0 * acceleration * length / STEP_ACCELERATION)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        seconds = 2.0 * length / (speed + middle) if middle > 0.0 else 0.0
        if seconds > 0.0 and STEP_JERK * (middle - speed) <= jerk * seconds * seconds:
            low = middle
        else:
            high = middle
    return low


def _line_time(begin: float, end: float, length: float, limits: Limits) -> float:
    """The least time for a line between two speeds that the smooth step can join."""
    if begin + end == 0.0:
        return rest_to_rest(length, limits)
    low, high = 0.0, 2.0 * length / (begin + end)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if middle > 0.0 and _keeps(middle, begin, end, length, limits):
            high = middle
        else:
            low = middle
    return high


def _keeps(seconds: float, begin: float, end: float, length: float, limits: Limits) -> bool:
    step, left = abs(end - begin), (length - 0.5 * (begin + end) * seconds) / seconds
    speed = max(begin, end) + PEAK_SPEED * left
    acceleration = (STEP_ACCELERATION * step + PEAK_ACCELERATION * left) / seconds
    jerk = (STEP_JERK * step + PEAK_JERK * left) / (seconds * seconds)
    return speed <= limits[0] and acceleration <= limits[1] and jerk <= limits[2]


def rest_to_rest(distance: float, limits: Limits) -> float:
    """The least time, s, of a minimum-jerk move over a distance (m)."""
    speed, acceleration, jerk = limits
    by_speed = PEAK_SPEED * distance / speed
    by_acceleration = (PEAK_ACCELERATION * distance / acceleration) ** 0.5
    by_jerk = (PEAK_JERK * distance / jerk) ** (1.0 / 3.0)
    return float(max(by_speed, by_acceleration, by_jerk))


def _segments(
    points: Sequence[Values], lines: list[_Line], cuts: list[float], speeds: list[float], ends: list[int]
) -> list[Segment]:
    """Line, corner, line, ..., line; ends: instants at which they meet, ns."""
    states: list[tuple[list[float], list[float], list[float]]] = []
    zero = [0.0] * len(points[0])
    for i, line in enumerate(lines):
        for point, away, speed in ((points[i], cuts[i], speeds[i]), (points[i + 1], -cuts[i + 1], speeds[i + 1])):
            place = [q + away * u for q, u in zip(point, line.direction, strict=True)]
            states.append((place, [speed * u for u in line.direction], zero))
    lengths = [after - before for before, after in pairwise(ends)]
    return [quintic(length, states[i], states[i + 1]) for i, length in enumerate(lengths) if length > 0]
