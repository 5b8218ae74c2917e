"""Reference trajectories: circle, Lissajous, point to point, hold, and the injection plan; see `make_trajectory`."""

from collections.abc import Sequence

import numpy as np

from hil.config import TaskConfig
from hil.laws.base import Array
from hil.trajectories.base import Trajectory
from hil.trajectories.figures import Figure, circle_oscillations, lissajous_oscillations
from hil.trajectories.injection import injection
from hil.trajectories.segments import Segments, move, rest

__all__ = ["Trajectory", "make_trajectory", "task_repeat"]


def make_trajectory(task: TaskConfig, axis_names: Sequence[str], start_position: Array, period_ns: int) -> Trajectory:
    """The rig's task, starting at rest at `start_position` (n_axes,) m; durations are rounded to whole control periods.

    Raises ValueError naming key, value and allowed range when the task cannot be done as asked.
    """

    def ns(seconds: float) -> int:
        return max(round(seconds * 1e9 / period_ns), 1) * period_ns

    start = np.array(start_position, dtype=np.float64)
    settle = round(task.settle_s * 1e9)
    if task.kind in ("circle", "lissajous"):
        first, second = (list(axis_names).index(name) for name in task.axes)
        if task.kind == "circle":
            figure = circle_oscillations(first, second, task.radius, task.frequency_hz, task.phase)
        else:
            figure = lissajous_oscillations(first, second, task.radius, task.frequency_hz, task.ratio, task.phase)
        return Figure(figure, start, ns(task.approach_s), settle)
    if task.kind == "injection":
        assert task.injection is not None  # TaskConfig has seen to it
        plan, in_focus = injection(task.injection, start, ns)
        plan.steady_from_ns = in_focus + settle
        return plan
    if task.kind == "point_to_point" and task.target:
        dwell = round(task.dwell_s * 1e9 / period_ns) * period_ns
        return _point_to_point(task, axis_names, start, ns(task.move_s), dwell, settle)
    still = Segments([rest(ns(1.0), start)], final=start, repeat=True, phase_names=("hold",))
    still.steady_from_ns = settle
    return still


def task_repeat(task: TaskConfig, axis_names: Sequence[str], period_ns: int) -> tuple[int, int] | None:
    """(period, first start) of the task's repeats, ns of task time; None where it does not repeat."""
    trajectory = make_trajectory(task, axis_names, np.zeros(len(axis_names)), period_ns)
    if trajectory.repeat_ns is None or task.kind == "hold":
        return None
    return trajectory.repeat_ns, trajectory.repeat_from_ns


def _point_to_point(
    task: TaskConfig, axis_names: Sequence[str], start: Array, move_ns: int, dwell_ns: int, settle_ns: int
) -> Segments:
    target = start.copy()
    for name, value in zip(task.axes, task.target, strict=True):
        target[list(axis_names).index(name)] = value
    there = [move(move_ns, start, target, 0), rest(dwell_ns, target, 1)]
    back = [move(move_ns, target, start, 2), rest(dwell_ns, start, 3)]
    parts = [segment for segment in there + back if segment.duration_ns > 0]
    trajectory = Segments(parts, final=start, repeat=True, phase_names=("move", "dwell", "back", "home"))
    trajectory.steady_from_ns = settle_ns
    return trajectory
