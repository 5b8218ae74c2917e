"""Kinds of task by name, and tasks that users bring: programs that give the path, run when the rig is loaded.

Of a user's task the rig keeps the samples (task.samples), as of a file. The path itself is planned, moved, replayed
and sent to other processes. No code of the user's runs in a tick.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from drivers.base import plugins
from drivers.base.guard import Guard
from drivers.base.plugins import Kind
from hil.rig.task_file import MOST_ROWS, Rows, sample_problems

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

_KINDS = "hil.control.trajectories.kinds"
TASKS: dict[str, str] = {
    "hold": f"{_KINDS}:hold",
    "circle": f"{_KINDS}:circle",
    "point_to_point": f"{_KINDS}:point_to_point",
    "lissajous": f"{_KINDS}:lissajous",
    "injection": f"{_KINDS}:injection_plan",
    "path": f"{_KINDS}:path",
    "waypoints": f"{_KINDS}:through_waypoints",
    "spline": f"{_KINDS}:through_spline",
    "raster": f"{_KINDS}:raster",
    "spiral": f"{_KINDS}:spiral",
}
KIND = Kind("task", "tasks", "task", "kind", "hil.tasks", TASKS, ("samples",))


class Task(ABC):
    """A motion of your own. Constructed with the names of the axes it moves (task.axes) and [task.parameters].

        class Rose(hil.Task):
            def __init__(self, axes, radius=1e-3):
                self.radius = radius

            def samples(self):
                time = numpy.linspace(0.0, 4.0, 401)
                ...
                return time, positions

    It is run once, when the rig is loaded; what it returns is part of the rig.
    """

    def __init__(self, axes: Sequence[str], **parameters: Any) -> None:
        self.axes = axes

    @abstractmethod
    def samples(self) -> "tuple[ArrayLike, ArrayLike]":
        """Times, (n,) s, rising; and positions, (n, axes) m (rad): 2 to 20000 rows. Derivatives are made for you."""


def is_users(kind: str) -> bool:
    """Whether a task's kind is a plug-in of users."""
    return kind not in TASKS


def run_task(kind: str, source: str, axes: Sequence[str], parameters: Mapping[str, Any]) -> Rows:
    """The samples of a user's task: rows of time (s) and positions (m, rad) in the order of `axes`.

    Raises ValueError that names the key, or file and line of what raised, or row and column of what is no position.
    """
    made = plugins.find(KIND, kind, source)
    plugins.check_parameters(KIND, kind, made, parameters, given=1)
    guard = Guard(KIND, kind, made)

    def run() -> tuple[Any, Any]:
        times, positions = made(list(axes), **parameters).samples()
        return times, positions

    times, positions = guard.call("", run)
    rows, problems = _rows(times, positions, len(axes))
    problems = problems or sample_problems(axes, rows)
    if problems:
        line = getattr(getattr(made.samples, "__code__", None), "co_firstlineno", 0)
        raise ValueError(guard.told(f"{guard.file}:{line}: samples", problems[0]))
    return rows


def _rows(times: Any, positions: Any, n_axes: int) -> tuple[Rows, list[str]]:
    """What `samples` returned as rows, or what keeps it from that."""
    import numpy as np

    try:
        time, position = np.asarray(times, dtype=np.float64), np.asarray(positions, dtype=np.float64)
    except (TypeError, ValueError) as error:
        return [], [f"no numbers: {error}"]
    if time.ndim != 1 or position.shape != (time.size, n_axes):
        shapes = f"times of shape {time.shape} and positions of shape {position.shape}"
        return [], [f"{shapes}, expected (n,) and (n, {n_axes})"]
    if time.size > MOST_ROWS:
        return [], [f"{time.size} rows, at most {MOST_ROWS}"]
    return np.column_stack([time, position]).tolist(), []
