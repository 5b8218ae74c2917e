"""What the axes do one plan after another: a trajectory that goals change as it goes.

Each axis has its own clock (ns since the course began) and its own plans. A new one begins in the motion that the one
before it has there, so that position, velocity and acceleration stay continuous; the last few are kept for instants of
samples from before that.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from hil.control.laws.base import Array
from hil.control.plans.axis_plan import AxisPlan
from hil.control.plans.pace import Pace, paced
from hil.control.trajectories.base import Times, Trajectory

KEPT: Final = 6
NS: Final = 1e-9
_ALWAYS: Final = -(1 << 60)  # ns


class Stretch:
    """From an instant on, ns: a plan of the axis, or a path at a pace that began at a path time, ns. follows: it
    goes on from a knot of a stream, and gives way to any other goal.
    """

    __slots__ = ("begins", "follows", "pace", "path", "path_ns", "plan")

    def __init__(
        self, begins: int, plan: AxisPlan, path: Trajectory | None = None, pace: Pace | None = None, path_ns: int = 0,
        follows: bool = False,
    ) -> None:  # fmt: skip
        self.begins = begins
        self.plan = plan
        self.path = path
        self.pace = pace
        self.path_ns = path_ns
        self.follows = follows

    def at(self, axis: int, t_ns: int) -> tuple[float, float, float]:
        """Position, velocity and acceleration at an instant, ns."""
        path, pace = self.path, self.pace
        if path is not None:
            if pace is not None:
                return paced(path, axis, self.path_ns, pace, (t_ns - self.begins) * NS)
            return path.at(axis, self.path_ns + t_ns - self.begins)
        return self.plan.at((t_ns - self.begins) * NS)


class Course(Trajectory):
    """Begins at rest at `start`, m by axis, or along a path, whose time is the course's."""

    phase_names: tuple[str, ...] = ("goals",)

    def __init__(self, start: Sequence[float], path: Trajectory | None = None) -> None:
        super().__init__(len(start))
        self._stretches: list[list[Stretch]] = []
        for axis, position in enumerate(start):
            here = path.at(axis, 0)[0] if path is not None else position
            first = Stretch(0 if path is not None else _ALWAYS, AxisPlan(here, 0.0, 0.0), path)
            self._stretches.append([first])

    def branch(self) -> "Course":
        """A course that does the same, whatever is added to either of them from here on."""
        copy = Course(())
        copy._n, copy._stretches = self._n, [list(kept) for kept in self._stretches]
        return copy

    def add(self, axis: int, stretch: Stretch) -> None:
        """Takes the place of what the axis would have done from then on."""
        kept = self._stretches[axis]
        while kept and kept[0].begins >= stretch.begins:
            kept.pop(0)
        kept.insert(0, stretch)
        if len(kept) > KEPT:
            kept.pop()

    def ahead(self, axis: int, t_ns: int) -> int:
        """How many of its stretches begin after an instant, ns."""
        return sum([stretch.begins > t_ns for stretch in self._stretches[axis]])

    def free(self, axis: int, t_ns: int) -> int:
        """From when on the axis may do something else than it does at an instant or will do: then, or where it has come
        to rest along a path, ns.
        """
        held = [stretch.begins for stretch in self._stretches[axis] if not stretch.follows]
        return max(t_ns, held[0]) if held else t_ns

    def newest(self, axis: int) -> Stretch:
        """What the axis does last."""
        return self._stretches[axis][0]

    def at(self, axis: int, t_ns: int) -> tuple[float, float, float]:
        """See Trajectory."""
        found = None
        for stretch in self._stretches[axis]:
            found = stretch
            if t_ns >= stretch.begins:
                break
        assert found is not None
        return found.at(axis, max(t_ns, found.begins))

    def _axis_array(self, axis: int, t_ns: Times) -> tuple[Array, Array, Array]:
        values = np.array([self.at(axis, instant) for instant in t_ns.ravel().tolist()]).reshape(-1, 3)
        return tuple(values[:, k].reshape(t_ns.shape).copy() for k in range(3))  # type: ignore[return-value]
