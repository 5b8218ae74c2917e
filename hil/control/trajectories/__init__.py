"""Reference trajectories: circle, Lissajous, point to point, hold, the injection plan, and paths through samples,
waypoints, a raster or a spiral; see `plan_task`.
"""

import math
from collections.abc import Mapping, Sequence
from functools import partial

from hil.control.laws.base import Array
from hil.control.trajectories.base import Plan, Trajectory
from hil.control.trajectories.figures import Figure, circle_oscillations, lissajous_oscillations
from hil.control.trajectories.injection import injection
from hil.control.trajectories.paths import Path, fitted_spline, raster_points, spiral_samples, spline, waypoints
from hil.control.trajectories.segments import Segments, move, rest
from hil.rig.schema import TaskConfig

PATHS = ("path", "waypoints", "spline", "raster", "spiral")

__all__ = ["Plan", "Trajectory", "make_trajectory", "plan_task", "task_repeat"]


def plan_task(task: TaskConfig, axis_names: Sequence[str], period_ns: int) -> Plan:
    """The rig's task, to begin at rest anywhere; durations are rounded to whole control periods.

    Raises ValueError naming key, value and allowed range when the task cannot be done as asked.
    """

    def ns(seconds: float) -> int:
        return max(round(seconds * 1e9 / period_ns), 1) * period_ns

    settle_ns = round(task.settle_s * 1e9)
    if task.kind in ("circle", "lissajous"):
        first, second = (list(axis_names).index(name) for name in task.axes)
        if task.kind == "circle":
            figure = circle_oscillations(first, second, task.radius, task.frequency_hz, task.phase)
        else:
            figure = lissajous_oscillations(first, second, task.radius, task.frequency_hz, task.ratio, task.phase)
        return lambda start: Figure(figure, start, ns(task.approach_s), settle_ns)
    if task.kind == "injection":
        assert task.injection is not None  # TaskConfig has seen to it
        return injection(task.injection, ns, settle_ns)
    if task.kind in PATHS:
        columns = [task.axes.index(name) if name in task.axes else -1 for name in axis_names]
        body = _path_body(task, period_ns)
        return lambda start: Path(body, columns, start, ns(task.approach_s), settle_ns)
    if task.kind == "point_to_point" and task.target:
        target = {list(axis_names).index(name): value for name, value in zip(task.axes, task.target, strict=True)}
        dwell_ns = round(task.dwell_s * 1e9 / period_ns) * period_ns
        return partial(_point_to_point, target, ns(task.move_s), dwell_ns, settle_ns)
    return partial(_hold, ns(1.0), settle_ns)


def _path_body(task: TaskConfig, period_ns: int) -> Segments:
    """What a path's task does once it is there: made before the drives are live, however many points it has."""

    def up(seconds: float) -> int:
        return math.ceil(max(seconds * 1e9 / period_ns - 1e-9, 1.0)) * period_ns

    limits = (task.speed, task.acceleration, task.jerk)
    dwell_ns = round(task.dwell_s * 1e9 / period_ns) * period_ns
    if task.kind == "spline":
        return fitted_spline(task.waypoints, limits, up, dwell_ns, repeat=task.repeat)
    if task.kind in ("waypoints", "raster"):
        points = task.waypoints if task.kind == "waypoints" else raster_points(task.corner, task.size, task.lines)
        return waypoints(points, limits, up, dwell_ns, task.blend, repeat=task.repeat)
    if task.kind == "spiral":
        return spline(spiral_samples(task.radius, task.turns, task.move_s, back=task.repeat), repeat=task.repeat)
    return spline(task.samples, repeat=task.repeat)


def make_trajectory(
    task: TaskConfig, axis_names: Sequence[str], start_position: Sequence[float] | Array, period_ns: int
) -> Trajectory:
    """The rig's task from rest at `start_position`, (n_axes,) m. Raises ValueError as `plan_task`."""
    return plan_task(task, axis_names, period_ns)([float(value) for value in start_position])


def task_repeat(task: TaskConfig, axis_names: Sequence[str], period_ns: int) -> tuple[int, int] | None:
    """(period, first start) of the task's repeats, ns of task time; None where it does not repeat."""
    trajectory = make_trajectory(task, axis_names, [0.0] * len(axis_names), period_ns)
    if trajectory.repeat_ns is None or task.kind == "hold":
        return None
    return trajectory.repeat_ns, trajectory.repeat_from_ns


def _point_to_point(
    target: Mapping[int, float], move_ns: int, dwell_ns: int, settle_ns: int, start: Sequence[float]
) -> Segments:
    there = [target.get(axis, value) for axis, value in enumerate(start)]
    parts = [move(move_ns, start, there, 0), rest(dwell_ns, there, 1)]
    parts += [move(move_ns, there, start, 2), rest(dwell_ns, start, 3)]
    lasting = [segment for segment in parts if segment.duration_ns > 0]
    trajectory = Segments(lasting, repeat=True, phase_names=("move", "dwell", "back", "home"))
    trajectory.steady_from_ns = settle_ns
    return trajectory


def _hold(duration_ns: int, settle_ns: int, start: Sequence[float]) -> Segments:
    still = Segments([rest(duration_ns, start)], repeat=True, phase_names=("hold",))
    still.steady_from_ns = settle_ns
    return still
