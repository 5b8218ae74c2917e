"""One control cycle, without I/O: received frames in, command frames and a telemetry record out. Read it top to bottom.

Rules:
- The output depends on the rig, the inputs and this object's own state alone. Time comes in as integer ns; no clock is
  read, and the same inputs give the same bytes.
- `step` never raises on any received bytes. Whatever cannot be trusted becomes a fault, and any fault that matters ends
  in a damped stop, in zero torque or in silence (fault_table.py).
- Force leaves through the gate alone (gate.py), which trusts neither law nor setpoint.

Theory of operation, in the order of `step`:

    decode     frames to at most one sample per axis           inbox.py
    estimate   sample instants, positions, motion filters      sampling.py, hil/control/estimator
    detect     what is wrong, as bits of one number            fault_monitor.py
    states     faults, exit, commands, progress                supervisor.py
    setpoint   where the stage should be                       hil/control/setpoints.py
    law        the force asked for                             hil/control/laws
    gate       the force applied                               gate.py
    encode     command frames                                  drivers/protocols
    record     all of it, for telemetry and replay             record_builder.py

A sample taken at s is seen one tick later, and the force computed from it acts from about one period after s: the
filters look ahead to that instant. Setpoints follow the samples' instants, so they are brought up to date as soon as
these are known: the detectors hold the motion against them, and a state that begins a task replaces them.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from drivers.frame import Frame
from drivers.protocols.base import DriveStatus, HostProtocol
from hil.control.estimator.motion_filter import expected_acceleration
from hil.control.laws.base import AxisLaws
from hil.cycle.axes import Axes
from hil.cycle.command_desk import CommandDesk
from hil.cycle.fault_monitor import FaultMonitor
from hil.cycle.fault_table import Fault, Reaction
from hil.cycle.gate import TorqueGate
from hil.cycle.homing import Homing
from hil.cycle.inbox import Inbox
from hil.cycle.limits import axis_limits, error_maps, force_limits, return_forces
from hil.cycle.output_gate import OutputGate
from hil.cycle.reading_faults import check_readings
from hil.cycle.readings import Readings
from hil.cycle.record_builder import RecordBuilder
from hil.cycle.sampling import Sampling
from hil.cycle.state_machine import TORQUE_STATES, State
from hil.cycle.supervisor import Supervisor
from hil.cycle.tick import CycleResult, Tick
from hil.cycle.withdrawal import shared
from hil.rig.layout import host_layout
from hil.rig.outputs import writers_of
from hil.rig.schema import RigConfig
from hil.rig.sensors import readers_of

# The stages of a tick that follow the decoding.
ESTIMATE: Final = 0
CONTROL: Final = 1
GATE: Final = 2
RECORD: Final = 3


class ControlCycle:
    """The control service's one step. Construct once per process from a validated rig; `base_dir` is the rig file's
    folder (DBC files). layout: the rig's, where who judged the rig has built it; it serves one cycle. Raises ValueError
    naming what this rig cannot do: its task, law, filter or layout.
    """

    def __init__(self, rig: RigConfig, base_dir: Path, layout: HostProtocol | None = None) -> None:
        self.rig = rig
        axes = list(rig.axes.values())
        self.protocol: HostProtocol = layout or host_layout(rig, base_dir)
        readers = readers_of(rig, base_dir, self.protocol)
        self.readings = Readings(list(rig.sensors.values()), readers, rig.period_ns) if readers else None
        writers = writers_of(rig, base_dir, self.protocol)
        self.outputs = OutputGate(list(rig.outputs.values()), writers, rig.period_ns) if writers else None
        self.inbox = Inbox(self.protocol, rig.safety.bad_frame_leak_ticks, self.readings, self.outputs)
        self.axes = Axes(rig)
        if self.readings is not None:
            for inputs in self.axes.inputs:
                inputs.readings = self.readings.newest
        self.inputs, self.filters, self.setpoints = self.axes.inputs, self.axes.filters, self.axes.setpoints
        resolution = [axis.encoder_resolution for axis in axes]
        wraps_ns = self.protocol.stamp_wraps_ns
        self.sampling = Sampling(
            self.inputs, self.inbox, resolution, rig.period_ns, self.protocol.acts_ns, wraps_ns,
            one_command=not rig.bus.segments, maps=error_maps(rig),
        )  # fmt: skip
        self.monitor = FaultMonitor(rig.safety, axis_limits(rig), rig.period_ns, self.axes.innovation_limit)
        self.gate = TorqueGate(self.protocol, force_limits(rig))
        self.homing: Homing | None = None
        if any(axis.home is not None for axis in axes):
            self.homing = Homing(
                rig, self.monitor, self.inbox, self.sampling, self.axes, self.gate, self.protocol
            )  # fmt: skip
        self.supervisor = Supervisor(
            rig, self.monitor, self.inbox, self.sampling, self.axes, self.readings, self.homing
        )  # fmt: skip
        self._return_force = return_forces(rig)
        self._soft = [False] * len(axes)  # axes that have no more than that: those on their way back
        self.records = RecordBuilder(len(axes))
        self.sent_sequence = -1
        self._sent_now_ns = 0
        self._heartbeat_ns = rig.safety.heartbeat_s * 1e9
        self._requested = self.axes.zero
        self._users_estimator = rig.estimator.is_users

    @property
    def state(self) -> State:
        """Where the state machine is."""
        return self.supervisor.machine.state

    @property
    def fault(self) -> Fault:
        """The fault that latched."""
        return self.supervisor.fault

    @property
    def problems(self) -> list[str]:
        """Why drives were refused or an axis is not as stated, for people."""
        push = self.supervisor.commissioning.problem
        sensors = [] if self.readings is None else self.readings.problems
        outputs = [] if self.outputs is None else self.outputs.problems
        return [*self.protocol.problems, *sensors, *outputs, *([push] if push else [])]

    @property
    def tip(self) -> str:
        """That the tip stays beyond its safe height, and how it comes out, for people; empty where it does not."""
        return self.supervisor.tip

    @property
    def failure(self) -> str:
        """Why a user's law or motion no longer counts, with file and line; empty where all is well."""
        decided = self.supervisor.goals.decided
        return self.axes.law.failure or ("" if decided is None else decided.failure)

    @property
    def silent(self) -> bool:
        """Nothing is sent until a reset."""
        return self.supervisor.silent

    @property
    def commands(self) -> CommandDesk:
        """What operators have asked for, and what became of it."""
        return self.supervisor.commands

    @property
    def law(self) -> AxisLaws:
        """The rig's control law."""
        return self.axes.law

    @law.setter
    def law(self, law: AxisLaws) -> None:
        self.axes.law = law

    def step(self, tick: Tick, frames: Sequence[Frame]) -> CycleResult:
        """One tick: `frames` are all received since the last one, oldest first. Never raises on any bytes."""
        readings = self.readings
        if readings is not None:
            readings.begin(self._sent_now_ns)
        self.inbox.collect(frames, self.sent_sequence)
        self._mark(ESTIMATE)
        self.monitor.begin()
        if readings is not None:
            readings.close()
            check_readings(readings, self.monitor)
        self._estimate(tick)
        self.setpoints.update(self.sampling.instants, self.sampling.starts)
        self._detect(tick)
        self._mark(CONTROL)
        before = self.supervisor.machine.state
        self.supervisor.advance(tick)
        out = self._act(tick) if self.supervisor.sends(before) else self._stay_silent()
        if readings is not None and out and out[-1].can_id == self.protocol.echo_id:  # the drives need no service
            out += readings.service()
        if self.outputs is not None:
            self._switch(self.outputs, out)
        self.axes.note_applied(self.gate.force)
        self._sent_now_ns = tick.now_ns
        self._mark(RECORD)
        return CycleResult(out, self._record(tick, frames, out))

    def _mark(self, stage: int) -> None:
        """A stage begins; for who wants to know where the time goes. The cycle itself reads no clock."""

    def _estimate(self, tick: Tick) -> None:
        """Move the filters to the samples' instants, correct them, and look ahead to where the next force will act."""
        sampling, axes = self.sampling, self.axes
        sampling.take(tick.now_ns, self._sent_now_ns, self.monitor)
        found = not sampling.tracked and all(self.inbox.heard)
        clocks, filters, measured, shares = sampling.clocks, self.filters, [], sampling.shares
        shown = axes.shown
        for axis, x in enumerate(self.inputs):
            motion, force, interval = filters[axis], axes.net_before[axis], x.sample_interval
            share = shares[axis]
            if share > 0.0:  # the force of the latest tick acted for a part of the interval, at its end
                motion.correct(force, interval * (1.0 - share), x.position, 0.0)
                force, interval = axes.net_last[axis], interval * share
            expected, stretch = expected_acceleration(x), clocks[axis].stretch
            motion.correct(force, interval, x.position, x.fresh, stretch)
            shown[axis].take(motion, expected, x.sample_interval, x.position, x.fresh, stretch)
            if found:
                motion.reseed(x.position)
                shown[axis].reseed(x.position)
            elif not x.fresh and sampling.tracked:
                x.position = motion.position
            motion.look_ahead(axes.net_last[axis], x.ahead)
            motion.tell(x)
            measured.append(x.position)
        sampling.tracked = sampling.tracked or found
        axes.measured = measured

    def _detect(self, tick: Tick) -> None:
        """Flag what is wrong with bus, timing, samples and motion."""
        monitor = self.monitor
        monitor.check_bus(tick, self.inbox.useless_now)
        monitor.check_timing(tick)
        monitor.check_grants(tick)
        state = self.supervisor.machine.state
        if monitor.switched:
            required = self.homing is not None and self.homing.required
            self._read_switches(homing=required or state is State.HOMING)
        monitor.check_samples(self.inbox, self.supervisor.enabled)
        if state not in TORQUE_STATES:
            monitor.check_released(self.inbox)
            monitor.check_rest(self.inbox)
            return
        filters, applied, following = self.filters, self.gate.force, state is not State.STOPPING
        released = self.supervisor.released
        handed = None if self.homing is None or not self.homing.hands_over else self.homing.handed
        for axis, x in enumerate(self.inputs):
            if released is not None:
                following = not released[axis]
            motion = filters[axis]
            moved = handed is not None and handed[axis]  # by its drive, which knows nothing of the setpoint
            if not moved:
                monitor.check_filter(axis, motion.innovation)
            monitor.check_motion(
                axis,
                x.position,
                motion.velocity,
                applied[axis],
                x.sample,
                x.end.position,
                following=following and not moved,
            )
            if monitor.travel[axis].wide or self._soft[axis]:
                self._soft[axis] = monitor.travel[axis].wide
                self.gate.bound(axis, self._return_force[axis] if self._soft[axis] else math.inf)
        if self._heartbeat_ns and tick.now_ns - (self.commands.heartbeat_ns or 0) > self._heartbeat_ns:
            monitor.flag_heartbeat(tick.now_ns, self.commands.heartbeat_ns)

    def _read_switches(self, *, homing: bool) -> None:
        """Limit switches: what is closed is a fault, and no force goes there."""
        monitor = self.monitor
        monitor.check_switches(self.inbox, homing=homing)
        for axis in monitor.switched:
            closed = monitor.closed[axis]
            self.gate.block(axis, low=bool(closed & DriveStatus.LIMIT_LOW), high=bool(closed & DriveStatus.LIMIT_HIGH))

    def _act(self, tick: Tick) -> list[Frame]:
        """Law, gate, encode."""
        gate, supervisor = self.gate, self.supervisor
        for axis, x in enumerate(self.inputs):
            x.force_before = x.force_last
            x.force_last = gate.force[axis]
        self._requested = self.axes.zero
        permitted = supervisor.machine.state in TORQUE_STATES
        if permitted:
            self._requested = self._ask()
            if not gate.finite(self._requested):
                self.monitor.flag_requests(self._requested)
                supervisor.latch(Fault.NOT_FINITE, Reaction.ZERO, tick)
                permitted = False
        self._mark(GATE)
        self.sent_sequence += 1
        return gate.release(
            self._requested,
            self.axes.measured,
            permitted=permitted,
            sequence=self.sent_sequence,
            reset=supervisor.take_reset(),
        )

    def _ask(self) -> list[float]:
        """The force asked for, N per axis: of the damped stop, what brakes open on, of the push, else of the law."""
        if self.supervisor.machine.state is State.STOPPING:
            damped = self.supervisor.damped_stop.force(self.axes.ahead_velocity())
            released = self.supervisor.released
            return damped if released is None else shared(self._of_law(), damped, released)
        if self.supervisor.opening > 0:
            return self.axes.weights()
        if self.supervisor.commissioning.running:
            return self.supervisor.commissioning.force(self.axes.ahead_velocity())
        if self.homing is not None and self.homing.hands_over:
            handed = self.homing.handed  # no torque of ours acts there: what holds the weight when it acts again
            weights = self.axes.weights()
            return [weights[axis] if handed[axis] else force for axis, force in enumerate(self._of_law())]
        return self._of_law()

    def _of_law(self) -> list[float]:
        try:
            return self.axes.law.force(self.inputs)
        except ArithmeticError:  # floats raise where arrays would say NaN; the gate knows what to do with that
            return [math.nan] * len(self.inputs)

    def _switch(self, outputs: OutputGate, out: list[Frame]) -> None:
        """Behind the drives' frames those of the outputs, as the motion asks."""
        decided, supervisor = self.supervisor.goals.decided, self.supervisor
        if out:
            asked = 0 if decided is None else decided.outputs
            permitted = supervisor.machine.state is State.ACTIVE and not self.monitor.active and not supervisor.fault
            spare = out[-1].can_id == self.protocol.echo_id  # neither drives nor sensors need a service frame
            out += outputs.release(asked, permitted=permitted)
            if spare:
                out += outputs.service()
        else:
            outputs.cut()
        if decided is not None:
            decided.given = outputs.set

    def _stay_silent(self) -> list[Frame]:
        """No force, and no frame."""
        for x in self.inputs:
            x.force_before = x.force_last
        self._requested = self.axes.zero
        self.gate.cut()
        self._mark(GATE)
        return []

    def _record(self, tick: Tick, received: Sequence[Frame], sent: list[Frame]) -> np.void:
        records, inbox, gate, supervisor = self.records, self.inbox, self.gate, self.supervisor
        records.tick(tick, supervisor.machine.state, supervisor.fault, self.monitor.active, sending=bool(sent))
        records.progress(max(self.sent_sequence, 0), self.setpoints.task_ns)
        filters, shown, instants = self.filters, self.axes.shown, self.sampling.instants
        for axis, x in enumerate(self.inputs):
            records.axis(axis, x, filters[axis], shown[axis].velocity, instants[axis])
            records.force(axis, self._requested[axis], gate.force[axis], gate.saturations[axis])
        if self._users_estimator:
            for axis, x in enumerate(self.inputs):
                records.estimate(axis, x.position_estimate, x.velocity_estimate)
        desk = supervisor.goals
        if desk.handled or desk.word != records.word or records.goals:  # mostly nothing of it changes
            counts = (desk.number, desk.limited, desk.superseded, desk.refused)
            records.motion(desk.word, counts, desk.handled)
        if desk.decided is not None:
            bits = 0 if self.outputs is None else self.outputs.set
            records.decided(bits, desk.decided.phase, desk.decided.cell, desk.limited + desk.decided.limited)
        if self.homing is not None:
            records.homing(self.homing.told)
        records.drives(inbox.age, [0 if s is None else s.status for s in inbox.samples])
        refused = supervisor.commands.refused
        records.counters(tick.port, inbox.rejects, inbox.lost, supervisor.machine.refused, refused)
        records.law_floors(self.axes.law.denominator_floors)
        if self.readings is not None:
            records.readings(self.readings.values, self.readings.age)
        if self.monitor.evidence:
            records.evidence(self.monitor.armed_evidence())
        return records.traffic(supervisor.commands.handled, sent, received)
