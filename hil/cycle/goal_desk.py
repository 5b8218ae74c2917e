"""The goal desk: takes goals while the rig is ACTIVE, and turns each into plans of the axes it is for.

Rules:
- The plan in hand ends at rest inside the fence. A new one replaces it, for all axes of its goal or for none, and only
  where it keeps fence, speed, acceleration and jerk. Else the old one goes on and the goal is refused, with a reason.
- A plan begins in the motion of the setpoint in force where the coming force begins to act, and takes effect in the
  frame of the tick that takes the goal.
- From a path (the task) a goal first stops along the path.
- A goal is tried on a copy of the course. A refused one changes nothing: the task, path or motion in hand goes on.
- Nothing here is trusted by gate or monitors, and nothing a goal holds can raise.

Theory of operation: the setpoints follow a `Course` (hil/control/plans/course.py) as long as goals move the axes, and a
mere position where they are at rest, so that no goal costs nothing.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final

from hil.control.motion.contract import Request
from hil.control.plans.axis_plan import AxisPlan, MotionLimits
from hil.control.plans.course import Course, Stretch
from hil.control.plans.moves import halt, jog, knot, move
from hil.control.plans.pace import MOST_RATE, Pace, change_rate
from hil.control.plans.stream import Knot, follow_on
from hil.control.plans.together import State, line, moves
from hil.control.trajectories import Trajectory
from hil.cycle.axes import Axes
from hil.cycle.decided_motion import DecidedMotion
from hil.cycle.goal import LINE, MOST_GOALS, MOST_JOG_S, RELATIVE, Goal, GoalKind, MotionWord, Refusal
from hil.cycle.sampling import Sampling

JOG_S: Final = 0.1  # that a jog lasts which does not say for how long
JOG_WAY: Final = 0.1  # of the travel, at most, in one jog
INWARD: Final = 0.2  # of speed and acceleration, from outside the fence
_WORDS: dict[int, MotionWord] = {
    GoalKind.MOVE: MotionWord.MOVE,
    GoalKind.JOG: MotionWord.JOG,
    GoalKind.KNOT: MotionWord.STREAM,
    GoalKind.HALT: MotionWord.MOVE,
}


class GoalDesk:
    """word: what the axes do. handled: the goals of this tick, each with what refused it. number: of the goal taken
    last. limited: knots that were brought within the limits. superseded, refused: goals without effect, so far.
    """

    def __init__(
        self, axes: Axes, sampling: Sampling, limits: Sequence[MotionLimits], paths: Sequence[float], interrupt: bool,
        decided: DecidedMotion | None = None,
    ) -> None:  # fmt: skip
        """paths: accelerations that a change of a path's rate may take, m/s^2 by axis. interrupt: goals end a task.
        decided: the motion that takes the task's place.
        """
        self._axes, self._sampling, self._limits = axes, sampling, list(limits)
        self._hard = [
            MotionLimits(li.speed, most, li.jerk, li.low, li.high) for li, most in zip(limits, paths, strict=True)
        ]
        self._interrupt = interrupt
        self.decided = decided
        self.word = MotionWord.NONE
        self.handled: list[tuple[Goal, int]] = []
        self.number = self.limited = self.superseded = self.refused = 0
        self._course: Course | None = None
        self._path: Trajectory | None = None
        self._ends_ns = -1  # of the path's time
        self._knots = [Knot()] * len(limits)  # the last of a stream, by axis

    def begin(self, path: Trajectory | None, word: MotionWord) -> None:
        """The setpoints have begun to follow `path`; None: they hold."""
        self._course, self._path, self.word = None, path, word
        duration = None if path is None else path.duration_ns
        self._ends_ns = -1 if duration is None else duration

    def decide(self, decided: DecidedMotion, origin_ns: Sequence[int]) -> None:
        """From rest, a motion that decides says where the axes go, first in this tick's `advance`; its time 0 is at
        `origin_ns`.
        """
        position = [x.end.position for x in self._axes.inputs]
        self._course, self._path, self.word = Course(position), None, MotionWord.MOTION
        self._axes.setpoints.follow(self._course, origin_ns)
        decided.begin(position)

    def withdraw(self, axis: int, target: float, seconds: float) -> float:
        """One axis goes to `target`, m, in about `seconds` or as soon as its limits allow, the others come to rest,
        whatever was asked for before. Returns how long it takes, s.
        """
        if self.decided is not None:
            self.decided.end()
        course = self._branch()
        for one, at in enumerate(self._commits()):
            state = course.at(one, at)
            li = self._limits_at(one, state[0])
            plan = move(*state, target, li, seconds) if one == axis else halt(*state, li)
            course.add(one, Stretch(at, plan))
        self._take_course(course)
        self._path, self.word = None, MotionWord.WITHDRAW
        return course.newest(axis).plan.ends

    def leave(self) -> None:
        """The axes are no longer ours to move."""
        if self.decided is not None:
            self.decided.end()
        self._course = self._path = None
        self.word = MotionWord.NONE

    def refuse(self, goals: Sequence[Goal]) -> None:
        """All of a tick, in a state that takes none."""
        self.handled = [(goal, int(Refusal.NOT_ACTIVE)) for goal in goals[:MOST_GOALS]]
        self.refused += len(goals)

    def advance(self, goals: Sequence[Goal], begin_path: Callable[[list[float]], Trajectory | None]) -> None:
        """One tick in ACTIVE. begin_path: the task's plan from rest at positions; None: it may not begin there."""
        if self.decided is not None and not self.decided.runs:
            self.decided.end()
        if goals:
            self._take(goals, begin_path)
        if self.word is MotionWord.MOTION:
            self._decide_on(self._course, self.decided)
        elif self._course is not None:
            self._watch_course(self._course)
        elif self._path is not None and 0 <= self._ends_ns <= self._axes.setpoints.task_ns:
            self._path, self.word = None, MotionWord.HOLD

    def _decide_on(self, course: Course | None, decided: DecidedMotion | None) -> None:
        """Where next; a motion that is over leaves the axes to come to rest on the plan in hand."""
        assert course is not None
        assert decided is not None
        decided.advance(course)
        if not decided.runs:
            self.word = MotionWord.MOVE

    def _watch_course(self, course: Course) -> None:
        """Once all axes have come to rest, also where the samples are, the setpoints merely hold again. Where a path
        is over they hold its end.
        """
        setpoints = self._axes.setpoints
        for axis, instant in enumerate(self._sampling.instants):
            stretch = course.newest(axis)
            at = instant - setpoints.origin[axis]
            if stretch.path is not None:
                if not 0 <= self._ends_ns <= self._path_time(course, axis, at)[0]:
                    return
            elif (at - stretch.begins) * 1e-9 < stretch.plan.ends:
                return
        path, self._path = self._path, None
        self._course, self.word = None, MotionWord.HOLD
        if path is None:
            setpoints.hold([course.newest(axis).plan.target for axis in range(len(self._limits))])

    def _take(self, goals: Sequence[Goal], begin_path: Callable[[list[float]], Trajectory | None]) -> None:
        """The newest of each kind, in order of arrival."""
        newest = {goal.kind: place for place, goal in enumerate(goals)}
        kept = [goal for place, goal in enumerate(goals) if newest[goal.kind] == place][-MOST_GOALS:]
        self.superseded += len(goals) - len(kept)
        for goal in kept:
            refusal = self._begin_path(begin_path) if goal.kind == GoalKind.PATH else self._act(goal)
            self.handled.append((goal, int(refusal)))
            if refusal is Refusal.NONE:
                self.number = goal.number
            else:
                self.refused += 1

    def _begin_path(self, begin_path: Callable[[list[float]], Trajectory | None]) -> Refusal:
        if self.word is not MotionWord.HOLD or self._course is not None:
            return Refusal.NO_PATH
        path = begin_path([x.end.position for x in self._axes.inputs])
        if path is None:
            return Refusal.NO_PATH
        self._axes.setpoints.follow(path, list(self._sampling.starts))
        self._update()
        self.begin(path, MotionWord.PATH)
        return Refusal.NONE

    def _ask(self, goal: Goal) -> Refusal:
        """The motion that runs hears what the operator asks for; nothing else changes."""
        decided = self.decided
        if self.word is not MotionWord.MOTION or decided is None:
            return Refusal.NO_MOTION
        if not Request.PAUSE <= goal.flags <= Request.ABORT:
            return Refusal.UNKNOWN
        decided.ask(Request(goal.flags))
        return Refusal.NONE

    def _act(self, goal: Goal) -> Refusal:
        if goal.kind == GoalKind.REQUEST:
            return self._ask(goal)
        axes = self._chosen(goal)
        refusal = self._wrong(goal, axes)
        if refusal is not Refusal.NONE:
            return refusal
        course = self._branch()
        if goal.kind == GoalKind.RATE:
            refusal = self._change_rate(course, goal.speed)
        else:
            refusal = self._stop_along_path(course)
            if refusal is Refusal.NONE:
                refusal = self._plan(course, goal, axes)
        if refusal is Refusal.NONE:
            self._take_course(course)
            self._say(goal)
        return refusal

    def _say(self, goal: Goal) -> None:
        """What the axes do since this goal was taken."""
        if goal.kind == GoalKind.RATE:
            if goal.speed == 0.0:
                self.word = MotionWord.PAUSED
            elif self.word is MotionWord.PAUSED:
                self.word = MotionWord.PATH
            return
        self._path, self.word = None, _WORDS[goal.kind]
        if self.decided is not None:
            self.decided.end()

    def _chosen(self, goal: Goal) -> list[int]:
        n = len(self._limits)
        mask = goal.mask or (1 << n) - 1
        return [axis for axis in range(n) if mask >> axis & 1] if 0 <= mask < 1 << n else []

    def _wrong(self, goal: Goal, axes: list[int]) -> Refusal:
        """What a goal says that cannot be, whatever the axes do."""
        known = goal.kind in _WORDS or goal.kind == GoalKind.RATE
        if not axes or not known or goal.flags & ~(RELATIVE | LINE):
            return Refusal.UNKNOWN
        if not all(math.isfinite(value) for value in (goal.speed, *goal.position, *goal.velocity)):
            return Refusal.NOT_FINITE
        if goal.kind == GoalKind.RATE:
            if self._path is None:
                return Refusal.NO_PATH
            return Refusal.NONE if 0.0 <= goal.speed <= MOST_RATE else Refusal.NOT_FINITE
        if self.word in (MotionWord.TASK, MotionWord.MOTION) and not self._interrupt:
            return Refusal.TASK
        if not 0.0 < goal.speed <= 1.0 or not 0 <= goal.due_ns < 1 << 40:
            return Refusal.NOT_FINITE
        if not 0 <= goal.valid_ns <= MOST_JOG_S * 1e9:
            return Refusal.NOT_FINITE
        return Refusal.NONE

    # the course ---------------------------------------------------------------------------------------------------

    def _branch(self) -> Course:
        """A copy of what the setpoints follow from here on, for goals to try."""
        if self._course is None:
            return Course([x.end.position for x in self._axes.inputs], self._path)
        return self._course.branch()

    def _origin(self) -> list[int]:
        """Where the course's time is 0, ns on the samples' clock, by axis; a course from rest begins now."""
        resting = self._course is None and self._path is None
        return list(self._sampling.starts if resting else self._axes.setpoints.origin)

    def _commits(self) -> list[int]:
        """Where the coming force begins to act, ns on the course's clock, by axis."""
        return [start - begun for start, begun in zip(self._sampling.starts, self._origin(), strict=True)]

    def _take_course(self, course: Course) -> None:
        """The setpoints follow it, in this tick already."""
        origin = self._origin()
        self._course = course
        self._axes.setpoints.follow(course, origin)
        self._update()

    def _update(self) -> None:
        self._axes.setpoints.update(self._sampling.instants, self._sampling.starts)

    def _change_rate(self, course: Course, wanted: float) -> Refusal:
        path = self._path
        assert path is not None
        commits = self._commits()
        here = [self._path_time(course, axis, at) for axis, at in enumerate(commits)]
        rate, slope = here[0][1], here[0][2]
        pace = change_rate(path, [place for place, _, _ in here], rate, slope, wanted, self._hard)
        if pace is None:
            return Refusal.LIMITS
        self._set_pace(course, path, pace, commits, [place for place, _, _ in here])
        return Refusal.NONE

    def _set_pace(
        self, course: Course, path: Trajectory, pace: Pace, commits: Sequence[int], places: Sequence[int]
    ) -> None:
        for axis, (at, place) in enumerate(zip(commits, places, strict=True)):
            rest = AxisPlan(path.at(axis, place)[0], 0.0, 0.0)
            course.add(axis, Stretch(at, rest, path, pace, place))

    def _path_time(self, course: Course, axis: int, at: int) -> tuple[int, float, float]:
        """Path time, ns, its rate and slope at an instant of the course."""
        stretch = course.newest(axis)
        if stretch.pace is None:
            return stretch.path_ns + at - stretch.begins, 1.0, 0.0
        gone, rate, slope = stretch.pace.at((at - stretch.begins) * 1e-9)
        return stretch.path_ns + int(gone * 1e9), rate, slope

    def _stop_along_path(self, course: Course) -> Refusal:
        """A path ends along itself; plans begin where it has come to rest."""
        path = self._path
        if path is None:
            return Refusal.NONE
        refusal = self._change_rate(course, 0.0)
        if refusal is not Refusal.NONE:
            return refusal
        for axis in range(len(self._limits)):
            stretch = course.newest(axis)
            assert stretch.pace is not None
            begins = stretch.begins + math.ceil(stretch.pace.ends * 1e9) + 1
            course.add(axis, Stretch(begins, AxisPlan(course.at(axis, begins)[0], 0.0, 0.0)))
        return Refusal.NONE

    # plans --------------------------------------------------------------------------------------------------------

    def _plan(self, course: Course, goal: Goal, axes: list[int]) -> Refusal:
        """New plans for the axes of a goal; none where one of them may not be."""
        limited, knots = self.limited, list(self._knots)
        commits = self._commits()
        begins = free = [course.free(axis, commits[axis]) for axis in axes]
        if goal.kind == GoalKind.KNOT:
            begins = [self._next_knot(course, goal, axis, at) for axis, at in zip(axes, free, strict=True)]
        states = [course.at(axis, at) for axis, at in zip(axes, begins, strict=True)]
        limits = [self._limits_at(axis, state[0]) for axis, state in zip(axes, states, strict=True)]
        plans, refusal = self._made(course, goal, axes, begins, states, limits)
        if refusal is Refusal.NONE and not all(p.keeps(li) for p, li in zip(plans, limits, strict=True)):
            refusal = Refusal.LIMITS
        if refusal is Refusal.NONE:
            for axis, at, plan, base in zip(axes, begins, plans, free, strict=True):
                course.add(axis, Stretch(at, plan, follows=at > base))
        else:
            self.limited, self._knots = limited, knots
        return refusal

    def _limits_at(self, axis: int, position: float) -> MotionLimits:
        """Outside the fence: inwards alone, and slowly."""
        return self._limits[axis].around(position, INWARD)

    def _made(
        self, course: Course, goal: Goal, axes: list[int], begins: list[int], states: list[State],
        limits: list[MotionLimits],
    ) -> tuple[list[AxisPlan], Refusal]:  # fmt: skip
        if goal.kind == GoalKind.HALT:
            return [halt(*state, li) for state, li in zip(states, limits, strict=True)], Refusal.NONE
        slowed = [li.slowed(goal.speed) for li in limits]
        if goal.kind == GoalKind.JOG:
            return [
                self._jog(goal, axis, state, li) for axis, state, li in zip(axes, states, slowed, strict=True)
            ], Refusal.NONE
        if goal.kind == GoalKind.KNOT:
            found = zip(axes, begins, states, slowed, strict=True)
            return [self._knot(goal, axis, at, state, li) for axis, at, state, li in found], Refusal.NONE
        targets = []
        for axis in axes:
            target = goal.position[axis]
            if goal.flags & RELATIVE:
                target += course.newest(axis).plan.target
            if not self._limits[axis].low <= target <= self._limits[axis].high:
                return [], Refusal.FENCE
            targets.append(target)
        # A goal that asks for less than what is in force slows down within what the axis has.
        chosen = [low if abs(s[1]) <= low.speed else li for low, li, s in zip(slowed, limits, states, strict=True)]
        planned = line if goal.flags & LINE else moves
        return planned(states, targets, chosen), Refusal.NONE

    def _jog(self, goal: Goal, axis: int, state: State, li: MotionLimits) -> AxisPlan:
        wanted = max(-li.speed, min(li.speed, goal.velocity[axis]))
        seconds = goal.valid_ns * 1e-9 or JOG_S
        if wanted != 0.0:
            seconds = min(seconds, JOG_WAY * (li.high - li.low) / abs(wanted))
        return jog(*state, wanted, seconds, self._limits_at(axis, state[0]))

    def _next_knot(self, course: Course, goal: Goal, axis: int, base: int) -> int:
        """From where on the axis goes to it: from the knot before, or from `base`."""
        li = self._limits[axis].slowed(goal.speed)
        place, speed, _ = course.at(axis, base)
        last = self._knots[axis] if self.word is MotionWord.STREAM else Knot(base, place, speed)
        place = max(li.low, min(li.high, goal.position[axis]))
        speed = max(-li.speed, min(li.speed, goal.velocity[axis]))
        new = last.next(base + goal.due_ns, place, speed)
        self._knots[axis] = new
        return follow_on(course, axis, last, new, base, li)

    def _knot(self, goal: Goal, axis: int, at: int, state: State, li: MotionLimits) -> AxisPlan:
        """Through the knot; where its hull does not prove the limits, a move to its place."""
        new = self._knots[axis]
        bend = max(-li.acceleration, min(li.acceleration, new.rise))
        exact = new.place == goal.position[axis] and new.speed == goal.velocity[axis]
        made = knot(*state, (new.place, new.speed, bend), (new.due_ns - at) * 1e-9, li)
        if made is None or not exact:
            self.limited += 1
        return made if made is not None else move(*state, new.place, self._limits_at(axis, state[0]))
