"""The kinds of task by name, each from a rig's [task] to a plan: what hil/rig/task_kinds.py lists.

Each takes the task, the names of the rig's axes, the control period (ns) and the axes' encoder counts (m). It raises
ValueError naming key, value and allowed range where the task cannot be done as asked. Durations are rounded to whole
periods.
"""

import math
from collections.abc import Mapping, Sequence
from functools import partial

from hil.control.trajectories.base import Plan
from hil.control.trajectories.figures import Figure, circle_oscillations, lissajous_oscillations
from hil.control.trajectories.injection import injection
from hil.control.trajectories.paths import AlongPath, apart, fitted_spline, raster_points, spiral_samples, waypoints
from hil.control.trajectories.rows import along_rows
from hil.control.trajectories.segments import Segments, move, rest
from hil.rig.schema import TaskConfig

Names = Sequence[str]
Counts = Sequence[float]


def _ns(seconds: float, period_ns: int) -> int:
    return max(round(seconds * 1e9 / period_ns), 1) * period_ns


def _settle_ns(task: TaskConfig) -> int:
    return round(task.settle_s * 1e9)


def hold(task: TaskConfig, axes: Names, period_ns: int, counts: Counts) -> Plan:
    """At rest where the stage stands."""
    return partial(_hold, _ns(1.0, period_ns), _settle_ns(task))


def _hold(duration_ns: int, settle_ns: int, start: Sequence[float]) -> Segments:
    still = Segments([rest(duration_ns, start)], repeat=True, phase_names=("hold",))
    still.steady_from_ns = settle_ns
    return still


def circle(task: TaskConfig, axes: Names, period_ns: int, counts: Counts) -> Plan:
    """Two axes on a circle."""
    first, second = (list(axes).index(name) for name in task.axes)
    figure = circle_oscillations(first, second, task.radius, task.frequency_hz, task.phase)
    return lambda start: Figure(figure, start, _ns(task.approach_s, period_ns), _settle_ns(task))


def lissajous(task: TaskConfig, axes: Names, period_ns: int, counts: Counts) -> Plan:
    """Two axes, one at a multiple of the other's frequency."""
    first, second = (list(axes).index(name) for name in task.axes)
    figure = lissajous_oscillations(first, second, task.radius, task.frequency_hz, task.ratio, task.phase)
    return lambda start: Figure(figure, start, _ns(task.approach_s, period_ns), _settle_ns(task))


def injection_plan(task: TaskConfig, axes: Names, period_ns: int, counts: Counts) -> Plan:
    """The paper's plan over a row of cells."""
    assert task.injection is not None  # TaskConfig has seen to it
    return injection(task.injection, lambda seconds: _ns(seconds, period_ns), _settle_ns(task))


def point_to_point(task: TaskConfig, axes: Names, period_ns: int, counts: Counts) -> Plan:
    """To a target and back; without one, at rest."""
    if not task.target:
        return hold(task, axes, period_ns, counts)
    target = {list(axes).index(name): value for name, value in zip(task.axes, task.target, strict=True)}
    return partial(_to_and_fro, target, _ns(task.move_s, period_ns), _dwell_ns(task, period_ns), _settle_ns(task))


def _to_and_fro(
    target: Mapping[int, float], move_ns: int, dwell_ns: int, settle_ns: int, start: Sequence[float]
) -> Segments:
    there = [target.get(axis, value) for axis, value in enumerate(start)]
    parts = [move(move_ns, start, there, 0), rest(dwell_ns, there, 1)]
    parts += [move(move_ns, there, start, 2), rest(dwell_ns, start, 3)]
    lasting = [segment for segment in parts if segment.duration_ns > 0]
    trajectory = Segments(lasting, repeat=True, phase_names=("move", "dwell", "back", "home"))
    trajectory.steady_from_ns = settle_ns
    return trajectory


# along a path that is made before the drives are live, however many points it has ------------------------------------


def path(task: TaskConfig, axes: Names, period_ns: int, counts: Counts) -> Plan:
    """Through samples in time, of a file or of a program that users bring."""
    return _along(timed_body(task), task, axes, period_ns)


def timed_body(task: TaskConfig) -> Segments:
    """The path of a task through samples in time, from their first on; what repeats ends where it begins."""
    rows = [*task.samples[:-1], [task.samples[-1][0], *task.samples[0][1:]]] if task.repeat else task.samples
    return along_rows(rows, task.between, repeat=task.repeat)


def through_spline(task: TaskConfig, axes: Names, period_ns: int, counts: Counts) -> Plan:
    """A spline through waypoints, as quick as the task's limits allow."""
    limits, dwell_ns = _limits(task), _dwell_ns(task, period_ns)
    points = _apart(task.waypoints, task, axes, counts)
    if len(points) < 2:
        raise ValueError("task.waypoints: all rows are one point, nearer to each other than an encoder count")
    body = fitted_spline(points, limits, partial(_up, period_ns), dwell_ns, repeat=task.repeat)
    return _along(body, task, axes, period_ns)


def through_waypoints(task: TaskConfig, axes: Names, period_ns: int, counts: Counts) -> Plan:
    """From waypoint to waypoint in straight lines."""
    return _lines(_apart(task.waypoints, task, axes, counts), task, axes, period_ns)


def raster(task: TaskConfig, axes: Names, period_ns: int, counts: Counts) -> Plan:
    """To and fro over a rectangle."""
    corners = raster_points(task.corner, task.size, task.lines)
    return _lines(_apart(corners, task, axes, counts), task, axes, period_ns)


def spiral(task: TaskConfig, axes: Names, period_ns: int, counts: Counts) -> Plan:
    """Outwards in two axes."""
    samples = spiral_samples(task.radius, task.turns, task.move_s, back=task.repeat)
    return _along(along_rows(samples, repeat=task.repeat), task, axes, period_ns)


def _lines(points: Sequence[Sequence[float]], task: TaskConfig, axes: Names, period_ns: int) -> Plan:
    dwell_ns, up = _dwell_ns(task, period_ns), partial(_up, period_ns)
    return _along(waypoints(points, _limits(task), up, dwell_ns, task.blend, repeat=task.repeat), task, axes, period_ns)


def _apart(points: Sequence[Sequence[float]], task: TaskConfig, axes: Names, counts: Counts) -> list[list[float]]:
    known = dict(zip(axes, counts, strict=True))
    return apart(points, [known[name] for name in task.axes], repeat=task.repeat)


def _along(body: Segments, task: TaskConfig, axes: Names, period_ns: int) -> Plan:
    columns = [task.axes.index(name) if name in task.axes else -1 for name in axes]
    return AlongPath(body, columns, _ns(task.approach_s, period_ns), _settle_ns(task))


def _limits(task: TaskConfig) -> tuple[float, float, float]:
    return task.speed, task.acceleration, task.jerk


def _dwell_ns(task: TaskConfig, period_ns: int) -> int:
    return round(task.dwell_s * 1e9 / period_ns) * period_ns


def _up(period_ns: int, seconds: float) -> int:
    return math.ceil(max(seconds * 1e9 / period_ns - 1e-9, 1.0)) * period_ns
