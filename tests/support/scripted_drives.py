"""A control cycle whose drives a test plays frame by frame: no wire, no plant, nothing but what the script says."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from drivers.bus.counters import BusState, PortCounters
from drivers.frame import Frame
from drivers.protocols import device_protocol
from drivers.protocols.base import Command, DriveStatus, Sample
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.step import ControlCycle
from hil.cycle.tick import CommandKind, OperatorCommand, Tick
from hil.rig.schema import RigConfig
from tests.support.paths import RIGS

ANSWER_NS = 300_000  # from a command's tick to the drives' answers


@dataclass(frozen=True)
class Script:
    """What a tick brings beyond healthy answers that obey.

    silent: axes whose answer is missing. status: bits axis 0 says besides. obeys: drives enable and disable as told.
    damaged: frames with a wrong checksum. unknown: frames that nobody knows. counted: growth of the port's counters.
    counts: how far the encoders have moved.
    """

    commands: tuple[CommandKind, ...] = ()
    silent: tuple[int, ...] = ()
    status: int = 0
    obeys: bool = True
    damaged: int = 0
    unknown: int = 0
    counted: dict[str, int] = field(default_factory=dict)
    bus: BusState = BusState.ERROR_ACTIVE
    slots: int = 1
    counts: int = 0


class Shown(NamedTuple):
    """What a tick did, without what counts on for ever (its number, its time, its sequence number)."""

    state: State
    fault: Fault
    active: int
    silent: bool
    refused: int
    ages: tuple[int, ...]
    command: Command | None
    estimate: tuple[float, ...]


class ScriptedDrives:
    """Construct with a rig; `tick` plays one control period. sample_ns: from a command's tick to the drives' sample.
    granted: what the next ticks say otherwise, as a Tick has it (`estop` too). record: of the latest tick.
    """

    def __init__(self, rig: RigConfig) -> None:
        rated = [axis.rated_force for axis in rig.axes.values()]
        self.rig = rig
        self.sample_ns = 100_000
        self.cycle = ControlCycle(rig, RIGS)
        self._device = device_protocol(rig.bus, len(rated), rated, RIGS)
        self._port = PortCounters()
        self._index, self._sequence, self._refused = -1, 0, 0
        self.granted: dict[str, Any] = {}
        self.record: np.void | None = None
        self._command: Command | None = None
        self._sent_ns, self._enabled = 0, 0

    def tick(self, script: Script = Script()) -> Shown:
        """One control period."""
        received = self._answers(script)
        self._index += script.slots
        now = self._index * self.rig.period_ns
        counted = {name: getattr(self._port, name) + more for name, more in script.counted.items()}
        self._port = self._port._replace(**counted, state=script.bus)
        commands = tuple(self._mail(kind, now) for kind in script.commands)
        tick = Tick(self._index, now, now, self._port, commands, **self.granted)
        result = self.cycle.step(tick, received)
        self.record = result.record
        self._command = None
        for frame in result.frames:
            command = self._device.decode_command(frame)
            assert isinstance(command, Command)
            self._command, self._sent_ns = command, now
        return self._shown()

    def _mail(self, kind: CommandKind, now: int) -> OperatorCommand:
        self._sequence += 1
        return OperatorCommand(kind, self._sequence, now)

    def _answers(self, script: Script) -> list[Frame]:
        """What the drives say to the latest command, and what else is on the bus."""
        frames = [Frame(0x7F0, b"") for _ in range(script.unknown)]
        command = self._command
        if command is None:
            return frames
        if script.obeys:
            self._enabled = command.enable
        for axis in range(len(self.rig.axes)):
            status = (DriveStatus.ENABLED if self._enabled >> axis & 1 else 0) | (0 if axis else script.status)
            stamp = self._sent_ns + self.sample_ns
            frame = self._device.encode_feedback(Sample(axis, script.counts, int(status), command.sequence, stamp))
            frame = frame._replace(timestamp_ns=self._sent_ns + ANSWER_NS)
            if axis not in script.silent:
                frames.append(frame)
            if axis == 0:
                wrong = bytes([frame.data[0] ^ 1]) + frame.data[1:]
                frames += [frame._replace(data=wrong)] * script.damaged
        return frames

    def _shown(self) -> Shown:
        cycle = self.cycle
        refused, self._refused = cycle.commands.refused - self._refused, cycle.commands.refused
        estimate = [value for f in cycle.filters for value in (f.position, f.velocity, f.innovation, f.ahead_velocity)]
        command = self._command and self._command._replace(sequence=0)
        return Shown(
            cycle.state, cycle.fault, cycle.monitor.active, cycle.silent, refused, tuple(cycle.inbox.age), command,
            tuple(estimate),
        )  # fmt: skip
