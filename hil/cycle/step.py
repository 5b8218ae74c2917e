"""One control cycle, without I/O: decode, estimate, detect faults, advance the state machine, sample the trajectory,
control law, gate, encode.

Output depends on the rig, the inputs and this object's own state alone; time comes in as integer ns.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from drivers.frame import Frame
from drivers.protocols import host_protocol
from drivers.protocols.base import UNHEALTHY, DriveStatus, HostProtocol
from hil.control.estimator.gains import design_gains
from hil.control.estimator.motion_filter import MotionFilter
from hil.control.laws import make_axis_laws
from hil.control.laws.base import AxisLaws, axis_inputs, axis_model
from hil.control.nominal_model import rig_model
from hil.control.setpoints import Setpoints, nominal_net_force
from hil.control.trajectories import plan_task, task_repeat
from hil.control.trajectories.homing import plan_homing
from hil.cycle.command_desk import CommandDesk
from hil.cycle.damped_stop import DampedStop
from hil.cycle.fault_monitor import FaultMonitor
from hil.cycle.fault_table import Fault, Reaction
from hil.cycle.gate import TorqueGate
from hil.cycle.inbox import Inbox
from hil.cycle.limits import axis_limits, force_limits
from hil.cycle.record import MAX_COMMANDS, RecordBuilder
from hil.cycle.sampling import Sampling
from hil.cycle.state_machine import SILENT_STATES, TORQUE_STATES, Event, State, StateMachine
from hil.cycle.tick import BusState, CycleResult, Tick
from hil.rig.schema import RigConfig

RESET_TICKS: Final = 3  # with the reset bit clear, then set: drives see its edge even if two frames of each are lost
# The stages of a tick that follow the reading of it.
ESTIMATE: Final = 0
CONTROL: Final = 1
GATE: Final = 2
RECORD: Final = 3
ENABLED: Final = int(DriveStatus.ENABLED)  # flags' own operators are slow
UNWELL: Final = int(UNHEALTHY)
# So is looking an enum's member up, which compiled code would do at every use.
_BOOT: Final = State.BOOT
_CONNECTED: Final = State.CONNECTED
_HOMING: Final = State.HOMING
_ACTIVE: Final = State.ACTIVE
_STOPPING: Final = State.STOPPING
_SHUTDOWN: Final = State.SHUTDOWN
_STOP: Final = Reaction.STOP


class ControlCycle:
    """The control service's one step. Construct once per process from a validated rig; `base_dir` is the rig file's
    folder (DBC files). Raises ValueError naming what this rig cannot do: its task, law, filter or layout.
    """

    def __init__(self, rig: RigConfig, base_dir: Path) -> None:
        self.rig = rig
        n = len(rig.axes)
        period = rig.period_ns * 1e-9
        axes = list(rig.axes.values())
        model = rig_model(rig)
        self.models = [axis_model(model, index) for index in range(n)]

        self.protocol: HostProtocol = host_protocol(
            rig.bus, n, [axis.rated_force for axis in axes], base_dir, rig.period_ns, rig.mountings
        )
        self.machine = StateMachine()
        self.inbox = Inbox(self.protocol, rig.safety.bad_frame_leak_ticks)
        gains, variance = design_gains(rig)
        self.filters = [MotionFilter(gains[:, i].tolist(), self.models[i].mass) for i in range(n)]
        innovation_limit = np.sqrt(variance * rig.safety.nis_limit).tolist()
        self.monitor = FaultMonitor(rig.safety, axis_limits(rig), rig.period_ns, innovation_limit)
        self.gate = TorqueGate(self.protocol, force_limits(rig))
        # Now, so that a task that cannot be done is refused, and none takes long to begin once the drives are live.
        self._plan, self._plan_homing = plan_task(rig.task, rig.axis_names, rig.period_ns), plan_homing(rig)
        learning = rig.law.iterative_learning
        repeat = task_repeat(rig.task, rig.axis_names, rig.period_ns) if learning else None
        force = np.array([axis.limits.force for axis in axes])
        self.law: AxisLaws = make_axis_laws(rig.law, model, period, force, repeat)
        self.commands = CommandDesk()
        self.inputs = [axis_inputs() for _ in range(n)]
        resolution = [axis.encoder_resolution for axis in axes]
        self.sampling = Sampling(self.inputs, self.inbox, resolution, rig.period_ns)
        self.setpoints = Setpoints(self.inputs, rig.period_ns)
        speed = [axis.limits.speed for axis in axes]
        self._stop = DampedStop(self.models, speed, period, rig.safety.stop_s)
        self.records = RecordBuilder(n)

        self.fault = Fault.NONE  # the one that latched
        self.sent_sequence = -1
        self.silent = False  # R4: nothing is sent until a reset
        self._reset_ticks = 0
        self._ready_ticks = 0
        self._waited_for_enable = 0
        self._enabled_seen = False
        self._stopping_since_ns = 0
        self._sent_now_ns = 0
        self._heartbeat_s = rig.safety.heartbeat_s
        self._zero = [0.0] * n
        self._measured = self._requested = self._zero
        self._net_last = self._net_before = self._zero  # the filters' known input, N

    @property
    def state(self) -> State:
        """Where the state machine is."""
        return self.machine.state

    def step(self, tick: Tick, frames: Sequence[Frame]) -> CycleResult:
        """One tick: `frames` are all received since the last one, oldest first. Never raises on any bytes."""
        monitor = self.monitor
        monitor.begin()
        self.inbox.collect(frames, self.sent_sequence)
        monitor.check_bus(tick, self.inbox.useless_now)
        monitor.check_timing(tick)
        monitor.check_grants(tick)
        monitor.check_samples(self.inbox, self._enabled_seen)
        self._mark(ESTIMATE)
        self._estimate(tick)
        self._mark(CONTROL)
        self._check_motion(tick)
        before = self.machine.state
        self._advance(tick)
        out = self._act(tick, before)
        self._mark(RECORD)
        return CycleResult(out, self._record(tick, frames, out))

    def _mark(self, stage: int) -> None:
        """A stage begins; for who wants to know where the time goes. The cycle itself reads no clock."""

    # estimate ---------------------------------------------------------------------------------------------------------

    def _estimate(self, tick: Tick) -> None:
        """Move the filters to the samples' instants, correct them, and look ahead to where the next force will act."""
        sampling = self.sampling
        sampling.take(tick.now_ns, self._sent_now_ns, self.monitor)
        found = not sampling.tracked and all(self.inbox.heard)
        clocks, filters, measured = sampling.clocks, self.filters, []
        for axis, x in enumerate(self.inputs):
            motion = filters[axis]
            motion.correct(self._net_before[axis], x.sample_interval, x.position, x.fresh, clocks[axis].stretch)
            if found:
                motion.reseed(x.position)
            elif not x.fresh and sampling.tracked:
                x.position = motion.position
            motion.look_ahead(self._net_last[axis], x.ahead)
            motion.tell(x)
            measured.append(x.position)
        sampling.tracked = sampling.tracked or found
        self._measured = measured
        self.setpoints.update(sampling.instants, sampling.starts)

    def _check_motion(self, tick: Tick) -> None:
        monitor, state = self.monitor, self.machine.state
        if state not in TORQUE_STATES:
            monitor.check_released(self.inbox)
            return
        filters, let_out, following = self.filters, self.gate.force, state is not _STOPPING
        for axis, x in enumerate(self.inputs):
            motion = filters[axis]
            monitor.check_filter(axis, motion.innovation)
            monitor.check_motion(
                axis, x.position, motion.velocity, let_out[axis], x.sample, x.end.position, following=following
            )
        heartbeat = self._heartbeat_s
        if heartbeat and tick.now_ns - (self.commands.heartbeat_ns or 0) > heartbeat * 1e9:
            monitor.see(Fault.HEARTBEAT_LOST)

    # advance ----------------------------------------------------------------------------------------------------------

    def _advance(self, tick: Tick) -> None:
        """Faults first, then exit, then the operator, then what the state itself has reached."""
        if self.machine.state is _BOOT:
            self._handle(Event.BUS_UP, tick)
        if self.monitor.active:
            fault, reaction = self.monitor.judge(self.machine.state)
            if reaction >= _STOP:
                self._latch(fault, reaction, tick)
        if tick.stop and self.machine.state not in (_STOPPING, _SHUTDOWN):
            self._handle(Event.EXIT, tick)
        self.commands.handle(tick.commands[:MAX_COMMANDS], tick.now_ns, lambda event: self._operate(event, tick))
        self._progress(tick)

    def _latch(self, fault: Fault, reaction: Reaction, tick: Tick) -> None:
        if self.fault is Fault.NONE:
            self.fault = fault
        self.silent = self.silent or reaction is Reaction.SILENT
        self._handle(Event.FAULT_ZERO if reaction >= Reaction.ZERO else Event.FAULT_STOP, tick)

    def _operate(self, event: Event, tick: Tick) -> bool:
        """An operator's event, after the guards the table cannot express."""
        if event in (Event.ACTIVATE, Event.HOME) and not self._may_activate(tick):
            return False
        if event is Event.RESET and (self.monitor.blocks_reset() or tick.port.state >= BusState.BUS_OFF):
            return False
        return self._handle(event, tick)

    def _may_activate(self, tick: Tick) -> bool:
        rig = self.rig
        if not tick.rig_ok or (rig.telemetry.recording_required and not tick.recorder_ok):
            return False
        if not tick.realtime_ok and not rig.timing.allow_degraded:
            return False
        heartbeat_ns = self.commands.heartbeat_ns
        alive = heartbeat_ns is not None and tick.now_ns - heartbeat_ns <= rig.safety.heartbeat_s * 1e9
        return not rig.safety.heartbeat_s or alive

    def _handle(self, event: Event, tick: Tick) -> bool:
        before = self.machine.state
        taken = self.machine.handle(event)
        if taken and (self.machine.state is not before or event is Event.RESET):
            self._enter(self.machine.state, event, tick)
        return taken

    def _enter(self, state: State, event: Event, tick: Tick) -> None:
        if state is State.CONNECTED:
            self._reconnect(reset=event is Event.RESET)  # what drives have latched, only the operator unlatches
        elif state is State.READY:
            self.fault = Fault.NONE
        elif state in (State.ACTIVE, State.HOMING):
            self._engage()
        elif state is State.STOPPING:
            self._stopping_since_ns = tick.now_ns
        if state not in TORQUE_STATES:
            self._enabled_seen = False

    def _reconnect(self, *, reset: bool) -> None:
        self.silent = False
        self.sampling.restart()
        self._ready_ticks = 0
        if not reset:
            self._reset_ticks = 0
        elif not self._reset_ticks:  # one on its way ends first: an impatient operator must not hold it up
            self._reset_ticks = 2 * RESET_TICKS
        self.fault = Fault.NONE
        self.inbox.forget()
        self.monitor.restart()

    def _engage(self) -> None:
        """Start at rest where the axes are: setpoint, filter and law know nothing of earlier runs."""
        self.monitor.restart()
        for x, motion in zip(self.inputs, self.filters, strict=True):
            motion.reseed(x.position)
            motion.tell(x)
        self._net_last = self._net_before = self._zero
        self.setpoints.hold(self._measured)
        self.law.reset(self._measured, [model.gravity for model in self.models])
        self._waited_for_enable = 0
        self._enabled_seen = False

    def _progress(self, tick: Tick) -> None:
        state = self.machine.state
        if state is _CONNECTED:
            self._await_axes(tick)
        elif state is _ACTIVE or state is _HOMING:
            if not self._enabled_seen:
                self._await_enable(tick)
            elif state is _HOMING and self._at_home():
                self._handle(Event.HOMED, tick)
        elif state is _STOPPING:
            elapsed = (tick.now_ns - self._stopping_since_ns) * 1e-9
            if self._stop.over([motion.ahead_velocity for motion in self.filters], elapsed):
                self._handle(self._after_stop(tick), tick)

    def _after_stop(self, tick: Tick) -> Event:
        if tick.stop:
            return Event.STOPPED_FOR_EXIT
        return Event.STOPPED_IN_FAULT if self.fault is not Fault.NONE else Event.STOPPED

    def _await_axes(self, tick: Tick) -> None:
        samples = self.inbox.samples
        healthy = all(self.inbox.fresh) and not any(s is None or s.status & UNWELL for s in samples)
        self._ready_ticks = self._ready_ticks + 1 if healthy and tick.port.state <= BusState.ERROR_PASSIVE else 0
        if self._ready_ticks >= self.rig.safety.ready_ticks:
            self._handle(Event.AXES_READY, tick)

    def _await_enable(self, tick: Tick) -> None:
        """The task's clock starts when every drive applies its torque."""
        self._waited_for_enable += 1
        if all(s is not None and s.status & ENABLED for s in self.inbox.samples):
            self._enabled_seen = True
            origin = [tick.now_ns + clock.latency for clock in self.sampling.clocks]
            begin = self._plan_homing if self.machine.state is State.HOMING else self._plan
            task = begin([x.sample.position for x in self.inputs])
            self.setpoints.follow(task, origin)
            self.setpoints.update(self.sampling.instants, self.sampling.starts)
        elif self._waited_for_enable >= self.rig.safety.enable_timeout_ticks:
            self._latch(Fault.ENABLE_TIMEOUT, Reaction.ZERO, tick)

    def _at_home(self) -> bool:
        trajectory = self.setpoints.trajectory
        duration = getattr(trajectory, "duration_ns", None)
        return duration is not None and self.setpoints.task_ns >= duration

    # act --------------------------------------------------------------------------------------------------------------

    def _act(self, tick: Tick, before: State) -> list[Frame]:
        """Law, gate, encode; nothing at all in silent states, save one last zero on the way into SHUTDOWN."""
        state, gate = self.machine.state, self.gate
        self._requested = self._zero
        for x in self.inputs:
            x.force_before = x.force_last
        if self.silent or (state in SILENT_STATES and before in SILENT_STATES):
            gate.cut()
            self._mark(GATE)
            self._remember_force(tick)
            return []
        for axis, x in enumerate(self.inputs):
            x.force_last = gate.force[axis]
        permitted = state in TORQUE_STATES
        if permitted:
            self._requested = self._ask(state)
            if not gate.finite(self._requested):
                self.monitor.see(Fault.NOT_FINITE)
                self._latch(Fault.NOT_FINITE, Reaction.ZERO, tick)
                permitted = False
        self._mark(GATE)
        self.sent_sequence += 1
        reset = 0 < self._reset_ticks <= RESET_TICKS
        self._reset_ticks = max(0, self._reset_ticks - 1)
        out = gate.release(
            self._requested, self._measured, permitted=permitted, sequence=self.sent_sequence, reset=reset
        )
        self._remember_force(tick)
        return out

    def _ask(self, state: State) -> list[float]:
        """The force asked for, N per axis: of the damped stop, else of the law."""
        if state is _STOPPING:
            return self._stop.force([motion.ahead_velocity for motion in self.filters])
        try:
            return self.law.force(self.inputs)
        except ArithmeticError:  # floats raise where arrays would say NaN; the gate knows what to do with that
            return [math.nan] * len(self.inputs)

    def _remember_force(self, tick: Tick) -> None:
        """The force just let out acts in the interval the setpoints' means belong to."""
        self._sent_now_ns = tick.now_ns
        self._net_before = self._net_last
        let_out, models = self.gate.force, self.models
        self._net_last = [
            nominal_net_force(let_out[axis], models[axis], x.mean_velocity, x.mean_sign)
            for axis, x in enumerate(self.inputs)
        ]

    # record -----------------------------------------------------------------------------------------------------------

    def _record(self, tick: Tick, received: Sequence[Frame], sent: list[Frame]) -> np.void:
        records, inbox, let_out, filters = self.records, self.inbox, self.gate.force, self.filters
        flags = tick.stop | tick.recorder_ok << 1 | tick.realtime_ok << 2 | tick.rig_ok << 3 | bool(sent) << 4
        records.tick(
            tick.index, tick.scheduled_ns, tick.now_ns, self.machine.state, self.fault, self.monitor.active, flags,
            max(self.sent_sequence, 0), self.setpoints.task_ns,
        )  # fmt: skip
        measured, requested, instants = self._measured, self._requested, self.sampling.instants
        saturations = self.gate.saturations
        for axis, x in enumerate(self.inputs):
            motion, reference = filters[axis], x.sample
            records.axis(
                axis, measured[axis], motion.position, motion.velocity, motion.disturbance, motion.innovation,
                reference.position, reference.velocity, requested[axis], let_out[axis], instants[axis],
                saturations[axis],
            )  # fmt: skip
        records.drives(inbox.age, [0 if s is None else s.status for s in inbox.samples])
        refused, floors = self.commands.refused, self.law.denominator_floors
        records.counters(tick.port, inbox.rejects, inbox.lost, self.machine.refused, refused, floors)
        return records.traffic(self.commands.handled, sent, received)
