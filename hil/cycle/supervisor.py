"""The supervisor: which state the control process is in, why, and what entering a state does.

Rules:
- In one tick, in this order: faults, the process's own end (SIGTERM), the operator's commands, and last what the state
  itself waits for (axes ready, drives enabled, at home, at rest). So no command outruns a fault of the same tick.
- The table in state_machine.py says which transitions exist. Guards (guards.py) refuse events that the table allows:
  ACTIVATE and HOME without a recorder, real time or heartbeat that the rig asks for; RESET while its cause is there;
  all three while an axis moves. ACTIVATE is refused where the task from here would break a limit
  (hil/analysis/start_ranges.py), and with LOAD_TASK where an axis is yet to be homed (homing.py). HOME is refused
  while the tip is beyond its safe height, as all axes go home together.
  A refused event is counted and has no other effect.
- An axis that rests beyond its travel has a way back: it may be held there (ACTIVATE_HOLD), with less force
  (limits.return_forces), and goals move it inwards, slowly. What it has come back it does not get again (travel.py).
- The first fault whose reaction is STOP or more latches; later ones do not replace it. A latched fault is left by an
  operator's RESET alone.
- Where the tip of a motion is beyond its safe height, it is led out first (WITHDRAW, withdrawal.py): STOPPING then has
  the law's force and the rig's own references, and the damped stop behind that.
- A run begins at rest where the axes are, and its task's clock starts in the tick in which the last drive says that it
  applies torque. Where the rig asks for a commissioning push, it starts behind that.
- Where brakes take time to open (drives.brake_opening_s), the weights' forces stand meanwhile. The law takes over as
  the last brake opens; the task or the push begins a tick later.

Theory of operation: `advance` is called once a tick, after the detectors. Every transition goes through `_handle`,
which asks the state machine and, where the state has changed (or was reset), `_enter` for the state's entry actions.
What the rest of the cycle needs to know of all this is `state`, `silent`, `sends` and `take_reset`.
"""

from typing import Final

from drivers.bus.counters import BusState
from drivers.protocols.base import UNHEALTHY, DriveStatus
from hil.analysis.start_ranges import start_ranges
from hil.control.motion.asked import AskedMotion
from hil.control.trajectories import Trajectory, plan_task
from hil.control.trajectories.homing import plan_homing
from hil.cycle.axes import Axes
from hil.cycle.command_desk import CommandDesk
from hil.cycle.commissioning import Commissioning
from hil.cycle.damped_stop import DampedStop
from hil.cycle.decided_motion import DecidedMotion
from hil.cycle.fault_monitor import FaultMonitor
from hil.cycle.fault_table import Fault, Reaction
from hil.cycle.goal import MotionWord
from hil.cycle.goal_desk import GoalDesk
from hil.cycle.guards import Guards, within
from hil.cycle.homing import Homing
from hil.cycle.inbox import Inbox
from hil.cycle.limits import motion_limits, path_accelerations
from hil.cycle.readings import Readings
from hil.cycle.record import MAX_COMMANDS
from hil.cycle.sampling import Sampling
from hil.cycle.state_machine import SILENT_STATES, TORQUE_STATES, Event, State, StateMachine
from hil.cycle.tick import CommandKind, Tick
from hil.cycle.withdrawal import WITHIN_S, Withdrawal
from hil.rig.schema import RigConfig

REST_TICKS: Final = 200  # most that an axis pushed by hand keeps the rig from READY; then it is STANDSTILL
RESET_TICKS: Final = 3  # with the reset bit clear, then set: drives see its edge even if two frames of each are lost


class Supervisor:
    """States, faults and commands of one control cycle. Raises ValueError naming a task that this rig cannot have.

    fault: the one that latched. silent: nothing is sent until a reset. enabled: every drive has said that it applies
    torque, and none has taken it back. opening: ticks that brakes still take to open. released: while the tip is led
    out, axes that have the damped stop's force all the same; None: it is not. way_out: of the rig's motion; None: it
    declares none. start_ranges: by axis, where the task may begin, m (rad). homing: how axes find their positions;
    None: none has to.
    """

    def __init__(
        self, rig: RigConfig, monitor: FaultMonitor, inbox: Inbox, sampling: Sampling, axes: Axes,
        readings: Readings | None = None, homing: Homing | None = None,
    ) -> None:  # fmt: skip
        self.machine = StateMachine()
        self.commands = CommandDesk()
        self.fault = Fault.NONE
        self.silent = False
        self.enabled, self.opening = False, 0
        speed = [axis.limits.speed for axis in rig.axes.values()]
        period_s = rig.period_ns * 1e-9
        self.damped_stop = DampedStop(axes.models, speed, period_s, rig.safety.stop_s)
        self.commissioning = Commissioning(rig.axes, axes.models, period_s, self.damped_stop, rig.safety.stop_s)
        self._rig, self._monitor, self._inbox, self._sampling, self._axes = rig, monitor, inbox, sampling, axes
        # Now, so that a task that cannot be done is refused, and none takes long to begin once the drives are live.
        self._plan, self._plan_homing = plan_task(rig.task, rig.axis_names, rig.period_ns, rig.counts), plan_homing(rig)
        self.start_ranges = start_ranges(rig)
        limits, paths = motion_limits(rig), path_accelerations(rig)
        decided: DecidedMotion | None = None
        if rig.motion.name:
            decided = DecidedMotion(AskedMotion(rig, limits), axes, sampling, limits, readings, rig.period_ns)
        interrupt = rig.motion.interrupt and not rig.law.iterative_learning
        self.goals = GoalDesk(axes, sampling, limits, paths, interrupt, decided)
        retreat = None if decided is None else decided.retreat
        self.way_out = None if retreat is None else Withdrawal(retreat, rig, limits)
        self.released: list[bool] | None = None
        self.homing = homing
        self.guards = Guards(rig, monitor, axes, self.commands, homing, self.way_out)
        self._went = 0.0  # m/s, velocity of the way out's axis when its torque ended
        self._reset_ticks = self._ready_ticks = self._waited_for_enable = self._stopping_since_ns = 0

    @property
    def state(self) -> State:
        """Where the state machine is."""
        return self.machine.state

    @property
    def longest_stop_s(self) -> float:
        """That STOPPING may take, s."""
        return self._rig.safety.stop_s + (0.0 if self.way_out is None else self.way_out.longest_s)

    @property
    def tip(self) -> str:
        """That the tip stays beyond its safe height, and how it comes out, for people; empty where it does not."""
        way_out = self.way_out
        if way_out is None or self.machine.state in TORQUE_STATES:
            return ""
        if not self._sampling.tracked or self.guards.homeless():
            return ""
        axis = way_out.axis
        seen = bool(self._inbox.fresh[axis])
        inside = way_out.needed(self._sampling.clocks[axis].trusted, 0.0 if seen else self._went)
        return way_out.left(seen=seen) if inside else ""

    def advance(self, tick: Tick) -> None:
        """Faults first, then exit, the operator, the stop line, and at last what the state itself has reached."""
        if self.homing is not None:
            self.homing.watch()
        if self.machine.state is State.BOOT:
            self._handle(Event.BUS_UP, tick)
        if self._monitor.active:
            fault, reaction = self._monitor.worst_fault(self.machine.state)
            if reaction >= Reaction.STOP:
                self.latch(fault, reaction, tick)
        if tick.stop and self.machine.state not in (State.STOPPING, State.SHUTDOWN):
            self._handle(Event.EXIT, tick)
        if tick.commands:
            commands, now_ns = tick.commands[:MAX_COMMANDS], tick.now_ns
            act, load = lambda event: self._operate(event, tick), lambda kind: self._load(kind, tick)
            self.commands.handle(commands, now_ns, act, load)
        else:
            self.commands.handled = []
        if tick.estop:  # after the operator: no RESET of the same tick undoes it
            self._handle(Event.ESTOP, tick)
        self._progress(tick)
        self._move(tick)

    def _move(self, tick: Tick) -> None:
        """Goals, once the axes are under torque and ours to move."""
        if self.goals.handled:
            self.goals.handled = []
        before = self.goals.word
        if before is not MotionWord.NONE and self.released is None:
            self.goals.advance(tick.goals, self._path_from)
            decided = self.goals.decided
            if before is MotionWord.MOTION and decided is not None and decided.failure and self.guards.inside():
                self._handle(Event.STOP, tick)
        elif tick.goals:
            self.goals.refuse(tick.goals)

    def _path_from(self, position: list[float]) -> Trajectory | None:
        """The task's plan from rest; None where it may not begin there."""
        path: Trajectory | None = self._plan(position) if within(position, self.start_ranges) else None
        return path

    def latch(self, fault: Fault, reaction: Reaction, tick: Tick) -> None:
        """React to a fault, and remember the first one."""
        if self.fault is Fault.NONE:
            self.fault = fault
        self._axes.distrust()
        if self.homing is not None and self.homing.hands_over:
            reaction = max(reaction, Reaction.ZERO)
        self.silent = self.silent or reaction is Reaction.SILENT
        self._handle(Event.FAULT_ZERO if reaction >= Reaction.ZERO else Event.FAULT_STOP, tick)

    def sends(self, before: State) -> bool:
        """Whether this tick sends anything, having begun in state `before`: the way into SHUTDOWN ends with a zero."""
        return not (self.silent or (self.machine.state in SILENT_STATES and before in SILENT_STATES))

    def take_reset(self) -> bool:
        """The drives' reset bit of the tick being sent."""
        reset = 0 < self._reset_ticks <= RESET_TICKS
        self._reset_ticks = max(0, self._reset_ticks - 1)
        return reset

    def _operate(self, event: Event, tick: Tick) -> bool:
        """An operator's event, where no guard is against it."""
        return self.guards.allow(event, tick, self.machine.state, self.start_ranges) and self._handle(event, tick)

    @property
    def at_rest(self) -> bool:
        """Another task or law may be loaded: the stage is READY, or holds for goals."""
        return self.machine.state is State.READY or self.goals.word is MotionWord.HOLD

    def _load(self, kind: int, tick: Tick) -> bool:
        """Another task or law, while the stage is at rest. A law that learns from the repeats of the rig's own task
        takes neither.
        """
        if not self.at_rest or self._rig.law.iterative_learning:
            return False
        if kind == CommandKind.SET_LAW:
            return tick.law is not None and self._axes.take_law(tick.law)
        task = tick.task
        if task is None or self.guards.homeless() or not self.guards.within(task.start_ranges):
            return False
        self._plan, self.start_ranges = task.plan, list(task.start_ranges)
        return True

    # entering a state -------------------------------------------------------------------------------------------------

    def _handle(self, event: Event, tick: Tick) -> bool:
        before = self.machine.state
        taken = self.machine.handle(event)
        if self.homing is not None and self.machine.state not in TORQUE_STATES:
            self.homing.leave(homed=event is Event.STOPPED)
        if taken and (self.machine.state is not before or event is Event.RESET):
            self._enter(self.machine.state, event, tick)
        return taken

    def _enter(self, state: State, event: Event, tick: Tick) -> None:
        if state is State.CONNECTED:
            self._reconnect(reset=event is Event.RESET)  # what drives have latched, only the operator unlatches
        elif state is State.READY:
            self.fault = Fault.NONE
            self._axes.hold()
        elif state in (State.ACTIVE, State.HOMING):
            self._engage()
            if state is State.HOMING and self.homing is not None:
                self.homing.open(self._axes.measured)
            if state is State.ACTIVE and self.commands.hold_asked:
                self._monitor.allow_way_back(self._axes.measured)
        elif state is State.STOPPING:
            self._stopping_since_ns = tick.now_ns
            self._lead_out(tick)
        if state is not State.STOPPING:
            self.released = None
        if state is not State.ACTIVE and self.released is None:
            self.goals.leave()
        if state not in TORQUE_STATES:
            self.enabled = False
            if self.way_out is not None:
                self._went = self._axes.ahead_velocity()[self.way_out.axis]
        if state not in (State.ACTIVE, State.HOMING):
            self.commissioning.cancel()

    def _reconnect(self, *, reset: bool) -> None:
        self.silent = False
        self._sampling.restart()
        self._ready_ticks = 0
        if not reset:
            self._reset_ticks = 0
        elif not self._reset_ticks:  # one on its way ends first: an impatient operator must not hold it up
            self._reset_ticks = 2 * RESET_TICKS
        self.fault = Fault.NONE
        self._inbox.forget()
        self._monitor.restart()
        if reset:
            self._monitor.forgive_switches()
        self._axes.hold()

    def _engage(self) -> None:
        self._monitor.restart()
        self._monitor.watch_rest(coasting=True)  # behind this run
        self._axes.rest()
        self._waited_for_enable = 0
        self.enabled, self.opening = False, self._rig.opening_ticks

    # what a state waits for -------------------------------------------------------------------------------------------

    def _progress(self, tick: Tick) -> None:
        state = self.machine.state
        if state is State.CONNECTED:
            self._await_axes(tick)
        elif state is State.ACTIVE or state is State.HOMING:
            if not self.enabled:
                self._await_enable(tick)
            elif self.opening >= 0:
                self._open(tick)
            elif self.commissioning.running:
                self._push(tick)
            elif state is State.HOMING:
                self._home(tick)
        elif state is State.STOPPING and self.released is not None:
            self._go_out(tick)
        elif state is State.STOPPING:
            elapsed = (tick.now_ns - self._stopping_since_ns) * 1e-9
            handed = self.homing is not None and self.homing.hands_over
            if handed or self.damped_stop.over(self._axes.ahead_velocity(), elapsed):
                self._handle(self._after_stop(tick), tick)

    def _await_axes(self, tick: Tick) -> None:
        samples = self._inbox.samples
        healthy = all(self._inbox.fresh) and not any(s is None or s.status & UNHEALTHY for s in samples)
        self._ready_ticks = self._ready_ticks + 1 if healthy and tick.port.state <= BusState.ERROR_PASSIVE else 0
        waited = self._ready_ticks - self._rig.safety.ready_ticks
        if waited >= REST_TICKS or (waited >= 0 and not self.guards.moves()):
            self._handle(Event.AXES_READY, tick)

    def _await_enable(self, tick: Tick) -> None:
        """The task's clock starts when every drive applies its torque."""
        self._waited_for_enable += 1
        if all(s is not None and s.status & DriveStatus.ENABLED for s in self._inbox.samples):
            self.enabled = True
            self._open(tick)
        elif self._waited_for_enable >= self._rig.safety.enable_timeout_ticks:
            self._monitor.flag_not_enabled(self._waited_for_enable, self._inbox)
            self.latch(Fault.ENABLE_TIMEOUT, Reaction.ZERO, tick)

    def _open(self, tick: Tick) -> None:
        """The brakes open; behind that the task, or the push before it, begins."""
        self.opening -= 1
        if self.opening == 0:
            self._axes.rest()  # here; the sample shows where the weights' forces have put them
        elif self.opening < 0 and self.commissioning.done:
            self._begin(tick)
        elif self.opening < 0:
            self.commissioning.start(self._axes.measured)

    def _push(self, tick: Tick) -> None:
        """The commissioning push; the task begins at rest behind it."""
        commissioning = self.commissioning
        commissioning.advance(self._axes.measured, self._axes.ahead_velocity())
        if commissioning.problem:
            self._monitor.flag(
                Fault.AXIS_NOT_AS_STATED, commissioning.moved, commissioning.expected, commissioning.axis
            )
            self.latch(Fault.AXIS_NOT_AS_STATED, Reaction.ZERO, tick)
        elif commissioning.done:
            self._axes.rest()
            self._begin(tick)

    def _begin(self, tick: Tick) -> None:
        """The task, or the way home, from where the axes are held."""
        sampling, setpoints = self._sampling, self._axes.setpoints
        if self.machine.state is State.ACTIVE and self.commands.hold_asked:
            self.goals.begin(None, MotionWord.HOLD)
            return
        origin = [tick.now_ns + clock.latency for clock in sampling.clocks]
        if self.machine.state is State.HOMING and self.homing is not None:
            self.homing.begin(origin)
            return
        decided = self.goals.decided
        if self.machine.state is State.ACTIVE and decided is not None:
            self.goals.decide(decided, origin)
            return
        begin = self._plan_homing if self.machine.state is State.HOMING else self._plan
        trajectory = begin([x.sample.position for x in self._axes.inputs])
        setpoints.follow(trajectory, origin)
        setpoints.update(sampling.instants, sampling.starts)
        if self.machine.state is State.ACTIVE:
            self.goals.begin(trajectory, MotionWord.TASK)

    def _lead_out(self, tick: Tick) -> None:
        """The tip to its safe height first, where it is beyond it and the axes are under control."""
        way_out = self.way_out
        if way_out is None or not self.enabled or self.goals.word is MotionWord.NONE:
            return
        way_out.begin()
        if self.guards.inside() and way_out.sound(self._monitor):
            way_out.due(tick.now_ns, self.goals.withdraw(way_out.axis, way_out.safe, WITHIN_S))
            self.released = way_out.released

    def _go_out(self, tick: Tick) -> None:
        """Until the tip is out, or the way out is out of control; the damped stop follows."""
        way_out = self.way_out
        assert way_out is not None
        if way_out.over(self._axes.measured[way_out.axis], tick.now_ns) or not way_out.sound(self._monitor):
            self.released = None
            self.goals.leave()
            self._stopping_since_ns = tick.now_ns

    def _home(self, tick: Tick) -> None:
        """The way home, or what finds the axes' positions."""
        homing = self.homing
        if homing is None:
            if self._at_home():
                self._handle(Event.HOMED, tick)
            return
        failed = homing.advance()
        if failed >= 0:
            self._monitor.flag_state(Fault.HOMING_FAILED, homing.why(failed), failed)
            self.latch(Fault.HOMING_FAILED, Reaction.STOP, tick)
        elif homing.over:
            self._handle(Event.HOMED, tick)

    def _at_home(self) -> bool:
        setpoints = self._axes.setpoints
        trajectory = setpoints.trajectory
        duration = None if trajectory is None else trajectory.duration_ns
        return duration is not None and setpoints.task_ns >= duration

    def _after_stop(self, tick: Tick) -> Event:
        if tick.stop:
            return Event.STOPPED_FOR_EXIT
        return Event.STOPPED_IN_FAULT if self.fault is not Fault.NONE else Event.STOPPED
