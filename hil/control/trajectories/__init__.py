"""Reference trajectories: a rig's task becomes a plan, and a plan, from where the stage rests, a trajectory.

The kinds of task and where each is made are listed in hil/rig/task_kinds.py; ours are in kinds.py.
"""

from collections.abc import Sequence

from drivers.base import plugins
from hil.control.laws.base import Array
from hil.control.trajectories.base import Plan, Trajectory
from hil.rig.schema import TaskConfig
from hil.rig.task_kinds import TASKS

__all__ = ["Plan", "Trajectory", "make_trajectory", "plan_task", "task_repeat"]


def plan_task(task: TaskConfig, axis_names: Sequence[str], period_ns: int, counts: Sequence[float] = ()) -> Plan:
    """The rig's task, to begin at rest anywhere; durations are rounded to whole control periods. counts: m by axis;
    points that are nearer to each other are one. Without any only the same point is.

    Raises ValueError naming key, value and allowed range when the task cannot be done as asked.
    """
    target = TASKS.get(task.kind, TASKS["path"])  # a task that users bring became samples when the rig was loaded
    plan: Plan = plugins.load(target)(task, axis_names, period_ns, counts or [0.0] * len(axis_names))
    return plan


def make_trajectory(
    task: TaskConfig, axis_names: Sequence[str], start_position: Sequence[float] | Array, period_ns: int,
    counts: Sequence[float] = (),
) -> Trajectory:  # fmt: skip
    """The rig's task from rest at `start_position`, (n_axes,) m. Raises ValueError as `plan_task`."""
    return plan_task(task, axis_names, period_ns, counts)([float(value) for value in start_position])


def task_repeat(
    task: TaskConfig, axis_names: Sequence[str], period_ns: int, counts: Sequence[float] = ()
) -> tuple[int, int] | None:
    """(period, first start) of the task's repeats, ns of task time; None where it does not repeat."""
    trajectory = make_trajectory(task, axis_names, [0.0] * len(axis_names), period_ns, counts)
    if trajectory.repeat_ns is None or task.kind == "hold":
        return None
    return trajectory.repeat_ns, trajectory.repeat_from_ns
