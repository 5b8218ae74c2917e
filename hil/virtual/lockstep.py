"""The cycle against the emulated stage over the simulated wire, in exact virtual time: the tick alone advances the
clock.

Same protocol, wire, drives, plant and cycle as a live run; same bytes every time, on any machine.
"""

import hashlib
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.bus.counters import PortCounters, of_all
from drivers.frame import ECHO, Frame, segment_of
from drivers.protocols.base import HostProtocol, echo_ids
from drivers.protocols.segments import segments_of
from drivers.wire.faults import Random, WireFault
from drivers.wire.node import WireNode
from drivers.wire.segments import Receiver, WireSegments, marking
from drivers.wire.wire import Wire
from hil.cycle.goal import Goal
from hil.cycle.state_machine import State
from hil.cycle.step import ControlCycle
from hil.cycle.tick import CommandKind, CycleResult, LoadedLaw, LoadedTask, OperatorCommand, Tick
from hil.live.task_loading import law_document, loaded_law, loaded_task, rig_with_law, rig_with_task, task_document
from hil.rig.schema import LawConfig, RigConfig, TaskConfig
from hil.virtual.emulate import emulated_outputs, emulated_sensors
from sim_plant.drives.servo import NEVER_NS
from sim_plant.emulator import EmulatedStage
from sim_plant.scenario.injector import Injector
from sim_plant.scenario.language import Scenario

Observer = Callable[[Tick, Sequence[Frame], CycleResult], None]
Operator = Callable[["LockstepRun", int], Sequence[CommandKind]]

_TRACE_HEAD = struct.Struct("<qHH")
_TRACE_FRAME = struct.Struct("<qIBB")
_TRACE_PARTS = 1000  # hashed at once
_COMMAND_LIFE_NS = 100_000_000


def activate_when_ready(run: "LockstepRun", index: int) -> Sequence[CommandKind]:
    """The operator of an ordinary run: activates as soon as the rig is READY, once."""
    return begin_when_ready(run, CommandKind.ACTIVATE)


def begin_when_ready(run: "LockstepRun", kind: CommandKind) -> Sequence[CommandKind]:
    """As soon as the rig is READY, once: ACTIVATE or ACTIVATE_HOLD; HOME before, where it has to be homed."""
    if run.cycle.state is not State.READY or run.activated_at >= 0:
        return ()
    homing = run.cycle.homing
    return (CommandKind.HOME,) if homing is not None and homing.required else (kind,)


class LockstepRun:
    """One run. Advance it tick by tick with `tick`, or whole with `run`.

    operator: says which commands arrive in a tick. observer: called with every tick's inputs and result, before the
    wire moves on. layout: the rig's, where who judged it has built one.
    """

    def __init__(
        self,
        rig: RigConfig,
        base_dir: Path,
        *,
        operator: Operator = activate_when_ready,
        observer: Observer | None = None,
        wire_faults: Sequence[WireFault] = (),
        scenario: Scenario | None = None,
        layout: HostProtocol | None = None,
    ) -> None:
        self.rig = rig
        self.base_dir = base_dir
        self.cycle = ControlCycle(rig, base_dir, layout)
        self._operator = operator
        self._observer = observer
        rated = [axis.rated_force for axis in rig.axes.values()]
        self.stage = EmulatedStage(
            rig.plant, rig.bus, rig.axis_names, rated, base_dir, drives=rig.drives, mountings=rig.mountings,
            sensors=emulated_sensors(rig, base_dir), outputs=emulated_outputs(rig, base_dir),
        )  # fmt: skip
        self.received: list[Frame] = []  # by the host since the last tick
        self._discarded = 0  # of those, beyond the receive limit
        self._echo_ids = echo_ids(self.cycle.protocol)
        self.hosts: list[WireNode] = []  # the host's, by segment
        self._axis_nodes: dict[str, WireNode] = {}
        self.wire = self._wired()
        for fault in wire_faults:
            self.wire.inject(fault)
        self.injector = Injector(scenario, self.stage, self.wire, rig.period_ns) if scenario else None
        self._active_since = -1  # tick in which the present ACTIVE began
        self._jitter = Random(rig.wire.seed ^ 0x6A697474)
        self._jitter_ns = round(rig.wire.jitter * 1e9)
        self._command_sequence = 0
        self._trace: list[bytes] = []  # not hashed yet
        self._hashed = hashlib.sha256()
        self.index = 0
        self.activated_at = -1  # tick of the first ACTIVE
        self.stop = False
        self.goals: list[Goal] = []  # of the next tick
        self.estop = False  # the stop line is pressed: for one tick
        self.truth = self.stage.sampled  # positions, velocities at the samples the latest tick worked on, m, m/s
        self._task: LoadedTask | None = None  # to be loaded in the next tick
        self._law: LoadedLaw | None = None  # to be set in it
        self.grants = {"recorder_ok": True, "realtime_ok": True, "rig_ok": True}  # as Tick has them

    def _wired(self) -> Wire | WireSegments:
        """The simulated bus with host, drives and axes on it."""
        rig, wires = self.rig, []
        segments = segments_of(rig.bus, len(rig.axes))
        for number, (axes, bus) in enumerate(segments):
            wire = Wire.from_config(bus, rig.wire.model_copy(update={"seed": rig.wire.seed + number}))
            to_host: Receiver = self.received.append
            to_drives: Receiver = self._to_drives
            if len(segments) > 1:
                to_host, to_drives = marking(to_host, number), marking(to_drives, number)
            self.hosts.append(wire.attach("host", to_host, bus.transmit_queue))
            wire.attach("drives", to_drives, accept=self.stage.acceptance)
            for axis in axes:
                name = rig.axis_names[axis]
                self._axis_nodes[name] = wire.attach(name, None, fifo=False)
            for name in (*rig.sensors, *self.stage.outputs.names) if not number else ():
                self._axis_nodes[name] = wire.attach(name, None, fifo=False)
            wires.append(wire)
        self._first_wire = wires[0]
        return wires[0] if len(wires) == 1 else WireSegments(wires)

    def wire_of(self, axis: int) -> Wire:
        """The segment that an axis is on."""
        wires = self.wire.wires if isinstance(self.wire, WireSegments) else [self.wire]
        return next(wire for wire in wires if self.rig.axis_names[axis] in wire.nodes)

    @property
    def host(self) -> WireNode:
        """The host's node; in a rig with several segments that on the first."""
        return self.hosts[0]

    def _to_drives(self, frame: Frame) -> None:
        if frame.can_id == self._echo_ids[segment_of(frame)]:
            self.received.append(frame._replace(flags=frame.flags | ECHO))
        answers = self.stage.on_frame(frame)
        for answer in answers:
            self._axis_nodes[self.stage.sender_of(answer)].send(answer, frame.timestamp_ns)
        if self.rig.sensors and (due_ns := self.stage.speaks_ns) < NEVER_NS:
            self._first_wire.at(due_ns, self._speak, due_ns)

    def _speak(self, now_ns: int) -> None:
        """What the stage's nodes send in their own time, up to now_ns."""
        for unasked in self.stage.advance(now_ns):
            self._axis_nodes[self.stage.sender_of(unasked)].send(unasked, self.stage.now_ns)

    def load_task(self, task: TaskConfig) -> None:
        """Ask for another task in the next tick; it is taken in READY. Raises RigError, ValueError as plan_task."""
        self._task = loaded_task(rig_with_task(self.rig, task_document(task)))

    def set_law(self, law: LawConfig) -> None:
        """Ask for another law in the next tick; it is taken at rest. Raises RigError, ValueError as make_axis_laws."""
        self._law = loaded_law(rig_with_law(self.rig, law_document(law)))

    def skip(self, slots: int) -> None:
        """Let `slots` periods pass without a tick: the control process was held up."""
        self.index += slots
        end_ns = self.index * self.rig.period_ns
        while (due_ns := max(self.stage.speaks_ns, self.wire.now_ns)) < end_ns:  # a drive may have to answer since
            self._advance(due_ns)
        self._advance(end_ns)

    def _advance(self, now_ns: int) -> None:
        """Wire and stage live to now_ns, and the drives say what they have to."""
        self.wire.advance(now_ns)
        self._speak(now_ns)

    def restart(self) -> None:
        """The control process has ended and another one begins: it has heard nothing and remembers nothing."""
        self.cycle = ControlCycle(self.rig, self.base_dir)
        self.received.clear()

    def tick(self) -> CycleResult:
        """One control period: cycle, send, and let the wire, the drives and the stage live until the next."""
        now = self.index * self.rig.period_ns
        frames = self._drain()
        tick = Tick(
            self.index,
            now,
            now,
            self._counters(),
            self._commands(now),
            stop=self.stop,
            estop=self.estop,
            task=self._task,
            law=self._law,
            goals=tuple(self.goals),
            **self.grants,
        )
        self._task = self._law = None
        self.goals = []
        self.estop = False
        result = self.cycle.step(tick, frames)
        if self.activated_at < 0 and self.cycle.state is State.ACTIVE:
            self.activated_at = self.index
        self.truth = self.stage.sampled
        self._send(result.frames, now)
        self._note(frames, result.frames)
        if self._observer:
            self._observer(tick, frames, result)
        if self.injector:
            self.injector.observe(now, self.cycle.state.name, self._phase())
        self.skip(1)
        return result

    def _drain(self) -> list[Frame]:
        """What the host received since the last tick; of a flood the newest, as drivers.bus.port has it."""
        limit = self.rig.bus.receive_limit
        self._discarded += max(0, len(self.received) - limit)
        frames = self.received[-limit:]
        self.received.clear()
        return frames

    def _counters(self) -> PortCounters:
        hosts = self.hosts
        counters = hosts[0].counters() if len(hosts) == 1 else of_all([host.counters() for host in hosts])
        return counters._replace(discarded=self._discarded) if self._discarded else counters

    def _phase(self) -> str:
        """Name of the task's phase; empty outside ACTIVE."""
        trajectory = self.cycle.setpoints.trajectory
        if self.cycle.state is not State.ACTIVE or trajectory is None:
            self._active_since = -1
            return ""
        if self._active_since < 0:
            self._active_since = self.index
        return trajectory.phase_names[trajectory.phase_at((self.index - self._active_since) * self.rig.period_ns)]

    def _commands(self, now: int) -> tuple[OperatorCommand, ...]:
        commands = []
        task = (CommandKind.LOAD_TASK,) if self._task else ()
        law = (CommandKind.SET_LAW,) if self._law else ()
        for kind in (*self._operator(self, self.index), *task, *law):
            self._command_sequence += 1
            commands.append(OperatorCommand(kind, self._command_sequence, now + _COMMAND_LIFE_NS))
        return tuple(commands)

    def _send(self, frames: Sequence[Frame], now: int) -> None:
        if self._jitter_ns:
            now += self._jitter.below(2 * self._jitter_ns + 1)
        for frame in frames:
            self.hosts[segment_of(frame)].send(frame, now)

    def _note(self, received: Sequence[Frame], sent: Sequence[Frame]) -> None:
        """Add a tick's frames to what is hashed."""
        trace = self._trace
        trace.append(_TRACE_HEAD.pack(self.index, len(received), len(sent)))
        for frames in (received, sent):
            for can_id, data, flags, stamp in frames:
                trace.append(_TRACE_FRAME.pack(stamp, can_id, flags, len(data)))
                trace.append(data)
        if len(trace) > _TRACE_PARTS:
            self._hash()

    def _hash(self) -> None:
        self._hashed.update(b"".join(self._trace))
        self._trace.clear()

    @property
    def trace_sha256(self) -> str:
        """Hash over every frame received and sent so far, with its tick."""
        self._hash()
        return self._hashed.hexdigest()

    @property
    def true_position(self) -> NDArray[np.float64]:
        """Position (m) of the samples the latest tick worked on, before the encoder, (n_axes,)."""
        return np.array(self.truth[0])

    @property
    def true_velocity(self) -> NDArray[np.float64]:
        """The same for velocity, m/s."""
        return np.array(self.truth[1])
