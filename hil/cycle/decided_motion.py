"""A motion that decides as it goes, in the cycle: asked once a tick, and trusted with nothing.

Rules:
- What it answers becomes a plan of each axis that ends at rest inside the fence: through the references asked for, and
  then the stop. Where these are beyond fence, speed, acceleration or jerk the axis goes there within them, and the tick
  is counted.
- No answer that can be used is no new plan: the one in hand ends at rest.
- Nothing here is trusted by gate or monitors, and nothing that a motion does can raise.
"""

from collections.abc import Sequence
from typing import Any, Final

from hil.control.motion.asked import AskedMotion
from hil.control.motion.contract import Observation, References, Request, Retreat
from hil.control.plans.axis_plan import MotionLimits
from hil.control.plans.course import Course, Stretch
from hil.control.plans.moves import knot, move
from hil.control.reading import Reading
from hil.cycle.axes import Axes
from hil.cycle.readings import Readings
from hil.cycle.sampling import Sampling

_NO_READINGS: Final[list[Reading]] = []
_NO_AGES: Final[list[int]] = []


class DecidedMotion:
    """outputs, phase, cell: as the motion says in this tick; 0 while it does not run. limited: ticks so far in which an
    axis was asked for more than its limits. runs: it is being asked. given: the outputs that the gate has set.
    """

    def __init__(
        self,
        asked: AskedMotion,
        axes: Axes,
        sampling: Sampling,
        limits: Sequence[MotionLimits],
        readings: Readings | None,
        period_ns: int,
    ) -> None:
        self._asked, self._axes, self._sampling, self._limits = asked, axes, sampling, list(limits)
        self._readings = _NO_READINGS if readings is None else readings.newest
        self._ages = _NO_AGES if readings is None else readings.age
        self._period_ns = period_ns
        self._period = period_ns * 1e-9
        self._tick = 0
        self._request = Request.NONE
        self.runs = False
        self.outputs = self.phase = self.cell = self.limited = self.given = 0

    @property
    def motion(self) -> Any:
        """The motion itself, for who reads its results."""
        return self._asked.motion

    @property
    def retreat(self) -> Retreat | None:
        """The way out that it declares."""
        return self._asked.retreat

    @property
    def failure(self) -> str:
        """Why it no longer counts, with file and line; empty where all is well."""
        return self._asked.failure

    def begin(self, position: Sequence[float]) -> None:
        """From rest at `position`, m by axis."""
        self.end()
        self._tick = 0
        self._asked.begin(position)
        self.runs = True

    def ask(self, request: Request) -> None:
        """The motion is told so in this tick."""
        self._request = request

    def end(self) -> None:
        """It is asked no more, and sets nothing."""
        self.runs = False
        self._request = Request.NONE
        self.outputs = self.phase = self.cell = 0

    def advance(self, course: Course) -> None:
        """One tick: from the references in force where the coming interval begins, to what it asks for at its end."""
        setpoints, sampling = self._axes.setpoints, self._sampling
        begins = [at - origin for at, origin in zip(sampling.starts, setpoints.origin, strict=True)]
        in_force = [course.at(axis, at) for axis, at in enumerate(begins)]
        filters = self._axes.filters
        answer = self._asked.step(
            Observation(
                self._tick,
                [at + self._period_ns for at in begins],
                [motion.ahead_position for motion in filters],
                [motion.ahead_velocity for motion in filters],
                in_force,
                list(self._readings),
                list(self._ages),
                self._request,
                self.given,
            )
        )
        self._request = Request.NONE
        self._tick += 1
        if answer is None:
            self.end()
            return
        limited = False
        for axis, (at, state) in enumerate(zip(begins, in_force, strict=True)):
            limited = self._follow(course, axis, at, state, answer) or limited
        self.limited += limited
        self.outputs, self.phase, self.cell = answer.outputs, answer.phase, answer.cell
        if answer.done:  # what it says last stands in this tick's record
            self.runs, self.outputs = False, 0
        setpoints.update(sampling.instants, sampling.starts)

    def _follow(
        self, course: Course, axis: int, at: int, state: tuple[float, float, float], answer: References
    ) -> bool:
        """A new plan for the axis, unless it rests and is to stay where it is; whether it was asked for too much."""
        li = self._limits[axis]
        position, velocity = answer.position[axis], answer.velocity[axis]
        if velocity == 0.0 and state == (position, 0.0, 0.0):
            return False
        place = max(li.low, min(li.high, position))
        speed = max(-li.speed, min(li.speed, velocity))
        bend = (velocity - state[1]) / self._period
        if answer.acceleration is not None:
            bend = answer.acceleration[axis]
        made = knot(*state, (place, speed, bend), self._period, li)
        limited = made is None or place != position or speed != velocity
        if made is None:
            made = move(*state, place, li.around(state[0], 1.0))
        course.add(axis, Stretch(at, made))
        return limited
