"""HOMING of a rig whose axes state how they find their position ([axes.NAME.home]), and what is known of it since.

Rules:
- Axes home by their `order`, those of one number together; the others are held.
- Before an axis is homed, its positions mean nothing. `farthest`, speed and force alone bound it: the gate and the
  detectors hold it to the way around where it stands, and every plan ends at rest inside that.
- Positions are those of before until all axes are done and without torque. Then they are shifted by whole counts.
- A drive that homes by itself does so alone, under no torque of the host. Its axis is held to the same way, and to a
  time. Whatever ends that before its time disables all drives at once: no damped stop acts on an axis that its drive
  moves. Its counts begin anew once on the way; positions go on where the axis is.
- An axis is no longer homed once its encoder's counts cannot be trusted: it was silent or at fault, it jumped, the
  drive says that it is not homed, or another process controls the rig. As long as the drive answers it counts on,
  whether it applies torque or not.
"""

import math
from collections.abc import Sequence
from typing import Final

from drivers.protocols.base import DriveStatus, HostProtocol
from drivers.protocols.finding import AxisFinder, AxisHomer, HomingTerms, Search
from hil.control.plans.axis_plan import AxisPlan, MotionLimits
from hil.control.plans.course import Course, Stretch
from hil.control.plans.moves import halt, move
from hil.cycle.axes import Axes
from hil.cycle.axis_homing import AxisHoming, Go, Seen, Step, Terms, Why
from hil.cycle.fault_monitor import FaultMonitor
from hil.cycle.fault_table import Fault
from hil.cycle.gate import TorqueGate
from hil.cycle.inbox import Inbox
from hil.cycle.limits import axis_limits, motion_limits
from hil.cycle.press_watch import PressWatch
from hil.cycle.sampling import Sampling
from hil.rig.home_table import LATCH_SPEED, SPEED, TOLD, HomeConfig
from hil.rig.layout import drive_homers, index_finders
from hil.rig.schema import RigConfig
from hil.rig.tables import AxisConfig

REACH: Final = 0.95  # of `farthest`: where plans end; what is left is for the loop
FORCE: Final = 0.5  # of what friction and gravity leave of `force`: for the plans' acceleration
PATIENCE_S: Final = 1.0
STEP: Final = 3.0  # of the search's speed
STEP_COUNTS: Final = 20  # beyond both the drive counts anew
LONGEST_S: Final = 5.0  # that a drive may take for what is no way
LOST: Final = frozenset({Fault.ENCODER_LOST, Fault.ENCODER_DEAD, Fault.ENCODER_JUMP, Fault.ENCODER_FAULT})
_HOMED: Final = int(DriveStatus.HOMED)


class Homing:
    """known: by axis, whether it is homed; one that states nothing is. over: all axes are done. running: they are not,
    and HOMING moves them. handed: by axis, its drive moves it.
    """

    def __init__(
        self, rig: RigConfig, monitor: FaultMonitor, inbox: Inbox, sampling: Sampling, axes: Axes, gate: TorqueGate,
        layout: HostProtocol,
    ) -> None:  # fmt: skip
        self._monitor, self._inbox, self._sampling, self._axes, self._gate = monitor, inbox, sampling, axes, gate
        stated = list(rig.axes.values())
        homes = [(number, axis, axis.home) for number, axis in enumerate(stated) if axis.home is not None]
        period_s = rig.period_ns * 1e-9
        self._one = {number: AxisHoming(_terms(axis, home, period_s)) for number, axis, home in homes}
        self._bits = {number: _switch(home) for number, _, home in homes}
        finders = [(rig.axis_names.index(name), found) for name, found in index_finders(rig, layout).items()]
        self._finders = {number: found for number, found in finders if isinstance(found, AxisFinder)}
        homers = [(rig.axis_names.index(name), found) for name, found in drive_homers(rig, layout).items()]
        self._homers = {number: found for number, found in homers if isinstance(found, AxisHomer)}
        self._asked = {number: _asked(axis, home) for number, axis, home in homes if number in self._homers}
        self._steps = {number: _step(self._one[number].terms, period_s) for number in self._homers}
        self.handed = [False] * len(stated)
        told = [number for number, _, home in homes if home.by in TOLD]
        self._told = frozenset(number for number in told if number not in self._finders and number not in self._homers)
        self._force = {number: home.force or math.inf for number, _, home in homes}
        self._limits = {number: _limits(axis, home, motion_limits(rig)[number]) for number, axis, home in homes}
        self._room = {number: home.farthest or axis.limits.following_error for number, axis, home in homes}
        self._press = {
            number: PressWatch(
                home.force or axis.limits.force, axis.limits.following_error, self._one[number].terms.latch_speed,
                period_s,
            )
            for number, axis, home in homes
        }  # fmt: skip
        orders = sorted({home.order for _, _, home in homes})
        self._groups = [[number for number, _, home in homes if home.order == order] for order in orders]
        self._travel = [(axis.limits.position[0], axis.limits.position[1]) for axis in stated]
        self._jumps = [limits.jump_step for limits in axis_limits(rig)]
        self.known = [axis.home is None or axis.home.by == "absolute" for axis in stated]
        self._places = [0.0] * len(stated)  # where the axes were last seen, m
        self._tracked = False
        self._course = Course(self._places)
        self._group = 0
        self.over = self.running = False

    @property
    def required(self) -> bool:
        """The rig may not be ACTIVE yet."""
        return not all(self.known)

    @property
    def told(self) -> int:
        """Of a record: the sub-state of the first axis that is not done; from bit 4 the axes that are not homed."""
        under_way = [self._one[axis] for axis in self._groups[self._group] if not self._one[axis].done]
        step = under_way[0].step if self.running and under_way else Step.NONE
        return int(step) | sum([16 << axis for axis, known in enumerate(self.known) if not known])

    # what is known ----------------------------------------------------------------------------------------------------

    def watch(self) -> None:
        """Once a tick, after the detectors: forget the axes whose counts cannot be trusted any more."""
        for found in self._monitor.evidence:
            if found.fault in LOST and found.axis in self._one:
                self._forget(found.axis)
        for axis in self._told:
            sample = self._inbox.samples[axis]
            if sample is not None and not sample.status & _HOMED:
                self._forget(axis)
        if not self._sampling.tracked:
            self._tracked = False
            return
        for axis, clock in enumerate(self._sampling.clocks):
            if not self._tracked and abs(clock.trusted - self._places[axis]) > self._jumps[axis]:
                self._forget(axis)  # its drive counts anew since the reset
            self._places[axis] = clock.trusted
        self._tracked = True

    def _forget(self, axis: int) -> None:
        if axis in self._one and self._one[axis].terms.by != "absolute":
            self.known[axis] = False

    # HOMING -----------------------------------------------------------------------------------------------------------

    def open(self, position: Sequence[float]) -> None:
        """The axes rest there, m, and are about to be moved."""
        self.over, self.running, self._group = False, True, 0
        for axis, one in self._one.items():
            one.restart()
            room, place = self._room[axis], position[axis]
            self._monitor.travel[axis].enclose(place - room, place + room)
            self._gate.enclose(axis, place - room, place + room)
            self._gate.bound(axis, self._force[axis])
            li = self._limits[axis]
            way = one.terms.way
            self._limits[axis] = MotionLimits(li.speed, li.acceleration, li.jerk, place - way, place + way)

    def begin(self, origin_ns: Sequence[int]) -> None:
        """The axes are under torque and at rest: the first of them go, at `origin_ns`."""
        self._course = Course([x.sample.position for x in self._axes.inputs])
        self._axes.setpoints.follow(self._course, origin_ns)
        self._begin_group()
        self._update()

    def _begin_group(self) -> None:
        for axis in self._groups[self._group]:
            self.known[axis] = self._one[axis].terms.by == "absolute"
            self._one[axis].begin(self._axes.measured[axis])
            self._press[axis].restart()
            sample = self._inbox.samples[axis]
            homed = sample is not None and bool(sample.status & _HOMED)
            if axis in self._finders:
                self._finders[axis].finder.begin()
            elif axis in self._homers:
                self._homers[axis].begin(self._asked[axis])
            else:
                self._sampling.clocks[axis].awaits_index = self._one[axis].terms.by == "index" and not homed

    def advance(self) -> int:
        """One tick: the axis that cannot be homed, -1 where none."""
        setpoints, sampling = self._axes.setpoints, self._sampling
        group = self._groups[self._group]
        moved = False
        for axis in group:
            at = sampling.starts[axis] - setpoints.origin[axis]
            go = self._one[axis].advance(self._seen(axis))
            if self._one[axis].why is not Why.NONE:
                return axis
            if go is not None:
                self._go(axis, at, go)
                moved = True
            elif axis in self._homers:
                moved = self._hand(axis, at) or moved
        if moved:
            self._update()
        elif all(self._one[axis].done for axis in group):
            if self._group + 1 < len(self._groups):
                self._group += 1
                self._begin_group()
            else:
                self.over = True
        return -1

    @property
    def hands_over(self) -> bool:
        """A drive moves its axis by itself: no torque of ours would stop that."""
        return True in self.handed

    def _hand(self, axis: int, at: int) -> bool:
        """Leave the axis to its drive while that moves it: the setpoint goes where the axis is. Then hold it there."""
        search, clock = self._homers[axis].homer.search, self._sampling.clocks[axis]
        away = search is Search.RUNNING
        if search is Search.FOUND:
            clock.rebases = 0.0
        if away:
            if not self.handed[axis]:
                self.handed[axis], clock.rebases = True, self._steps[axis]
            self._course.add(axis, Stretch(at, AxisPlan(self._axes.measured[axis], 0.0, 0.0)))
        elif self.handed[axis]:
            self.handed[axis] = False
            self._axes.rest()
            self._course = Course(self._axes.measured)
            self._axes.setpoints.follow(self._course, self._sampling.starts)
            return True
        return away

    def why(self, axis: int) -> int:
        """Which of HOMING_FAILED's words says what went wrong."""
        return int(self._one[axis].why) - 1

    def leave(self, *, homed: bool) -> None:
        """The axes are without torque. homed: all went well, and they are where they have been found to be."""
        if not self.running:
            return
        self.running = False
        for axis, one in self._one.items():
            clock = self._sampling.clocks[axis]
            clock.awaits_index = False
            if axis in self._finders:
                self._finders[axis].finder.end()
            if axis in self._homers:
                self._homers[axis].homer.end()
            self.handed[axis], clock.rebases = False, 0.0
            self._monitor.travel[axis].restart()
            self._gate.enclose(axis, *self._travel[axis])
            self._gate.bound(axis, math.inf)
            if homed and self.over:
                self._axes.move_origin(axis, clock.shift(one.shift))
                self._places[axis] = clock.trusted
                self.known[axis] = True

    def _seen(self, axis: int) -> Seen:
        x, sample = self._axes.inputs[axis], self._inbox.samples[axis]
        assert sample is not None
        newest, at = self._course.newest(axis), self._sampling.instants[axis] - self._axes.setpoints.origin[axis]
        blocked = self._press[axis].take(x.position, x.sample.position, x.sample.velocity, self._gate.force[axis])
        ended = (at - newest.begins) * 1e-9 >= newest.plan.ends
        told, homed, search = sample.position, bool(sample.status & _HOMED), Search.NONE
        if axis in self._homers:
            search = self._homers[axis].homer.search
            homed = search is Search.FOUND
        if axis in self._finders:
            found = self._finders[axis]
            search = found.finder.search
            homed = search is Search.FOUND
            if homed:
                told -= found.count
            elif search is Search.RUNNING and ended and self._one[axis].under_way:
                found.finder.settle()
                search = Search.ASKED
        return Seen(
            x.position,
            sample.position + self._sampling.clocks[axis].offset,
            told,
            self._inbox.fresh[axis],
            bool(sample.status & self._bits[axis]),
            homed,
            blocked,
            ended,
            search,
        )

    def _go(self, axis: int, at: int, go: Go) -> None:
        """A new plan from the motion in force."""
        state, li = self._course.at(axis, at), self._limits[axis]
        self._press[axis].restart()
        if go.target is None:
            self._course.add(axis, Stretch(at, halt(*state, li)))
            return
        slow = MotionLimits(max(go.speed, abs(state[1])), li.acceleration, li.jerk, li.low, li.high)
        self._course.add(axis, Stretch(at, move(*state, max(li.low, min(li.high, go.target)), slow)))

    def _update(self) -> None:
        self._axes.setpoints.update(self._sampling.instants, self._sampling.starts)


def _terms(axis: AxisConfig, home: HomeConfig, period_s: float) -> Terms:
    speed = home.speed or SPEED * axis.limits.speed
    return Terms(
        home.by,
        home.direction,
        speed,
        home.latch_speed or LATCH_SPEED * speed,
        REACH * (home.farthest or axis.limits.following_error),
        round(home.at / axis.encoder_resolution),
        home.move_to,
        axis.encoder_resolution,
        round(PATIENCE_S / period_s),
        round(_longest(home, speed) / period_s) if home.by_itself else 0,
    )


def _longest(home: HomeConfig, speed: float) -> float:
    """That a drive may take: there and back at the search's speed, once at the last approach's, s."""
    farthest, slow = home.farthest or 0.0, home.latch_speed or LATCH_SPEED * speed
    return LONGEST_S + 2.0 * farthest / speed + farthest / slow


def _step(terms: Terms, period_s: float) -> float:
    """What no axis makes in a tick whose drive homes at that speed, m."""
    return STEP * terms.speed * period_s + STEP_COUNTS * terms.resolution


def _asked(axis: AxisConfig, home: HomeConfig) -> HomingTerms:
    """What its drive is told, at the axis."""
    speed, count = home.speed or SPEED * axis.limits.speed, axis.encoder_resolution
    slow = home.latch_speed or LATCH_SPEED * speed
    acceleration, force = home.acceleration or 0.0, home.force or axis.limits.force
    return HomingTerms(home.method or 0, speed / count, slow / count, acceleration / count, force)


def _switch(home: HomeConfig) -> int:
    """The status bit that the axis homes on."""
    if home.by == "limit":
        return int(DriveStatus.LIMIT_LOW if home.direction < 0 else DriveStatus.LIMIT_HIGH)
    return int(DriveStatus.HOME)


def _limits(axis: AxisConfig, home: HomeConfig, goals: MotionLimits) -> MotionLimits:
    """Of the plans: those of goals, and so little that `force` is enough."""
    acceleration = goals.acceleration
    if home.force:
        free = home.force - axis.model.coulomb - abs(axis.model.gravity)
        acceleration = min(acceleration, FORCE * free / axis.model.mass)
    return MotionLimits(goals.speed, acceleration, goals.jerk * acceleration / goals.acceleration, 0.0, 0.0)
