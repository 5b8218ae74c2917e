"""The CANopen master's side of one drive: finds it, configures it over SDO, starts it, follows its states.

Time is counted in ticks (calls of `HostProtocol.encode`): the master has no clock.
"""

from collections.abc import Sequence
from enum import Enum, auto
from typing import NamedTuple

from drivers.frame import Frame
from drivers.protocols.base import DriveStatus
from drivers.protocols.canopen import cia301
from drivers.protocols.canopen.cia301 import Abort, DriveState, Emergency, NmtCommand, NmtState

SDO_TIMEOUT_TICKS = 100
RETRY_TICKS = 1000  # after a refusal, before the node is asked again from the start
LOST_TICKS = 500  # no heartbeat and no TPDO for so long: the node is gone

_WATCHDOG, _ENCODER_FAULT = int(DriveStatus.WATCHDOG), int(DriveStatus.ENCODER_FAULT)
_UPLOAD, _DOWNLOAD = 0x40, 0x23
_UPLOAD_ANSWER, _DOWNLOAD_ANSWER, _ABORT = 0x43, 0x60, 0x80


class Step(NamedTuple):
    """One SDO access. size: bytes of `value` to write; or 0: read, and check that the answer & mask is `value`."""

    object_index: int
    subindex: int
    value: int
    size: int = 0
    mask: int = 0


class Phase(Enum):
    """Where the master is with a node."""

    CONFIGURE = auto()
    START = auto()
    RUNNING = auto()
    REFUSED = auto()


class NodeMaster:
    """One drive as the master sees it.

    phase: progress. state: of its power state machine, None before the first TPDO. alarms: DriveStatus bits its
    emergency messages stand for. problem: why it was refused, for people.
    """

    def __init__(self, node_id: int, steps: Sequence[Step]) -> None:
        self.node_id = node_id
        self._steps = tuple(steps)
        self.problem = ""
        self._tick = 0
        self._heard_tick = 0
        self.restart()

    def restart(self) -> None:
        """The node is to be configured from the start: it booted, or was lost."""
        self.phase = Phase.CONFIGURE
        self.state: DriveState | None = None
        self.alarms = 0
        self._step = 0
        self._asked_tick = -1  # of the request not answered yet
        self._since_tick = self._tick  # of the current phase

    # what it says -----------------------------------------------------------------------------------------------------

    def on_heartbeat(self, state: int) -> None:
        """A heartbeat, or the boot-up message."""
        self._heard_tick = self._tick
        if state == NmtState.BOOT_UP:
            self.restart()
        elif self.phase is Phase.RUNNING and state != NmtState.OPERATIONAL:
            self._enter(Phase.START)

    def on_state(self, state: DriveState) -> None:
        """The state in a TPDO."""
        self._heard_tick = self._tick
        if self.state is DriveState.FAULT and state is not DriveState.FAULT:
            self.alarms = 0
        self.state = state
        if self.phase is Phase.START:
            self._enter(Phase.RUNNING)

    def on_emergency(self, code: int) -> None:
        """An emergency message: the reason of a fault that the statusword does not tell."""
        if code == Emergency.NONE:
            self.alarms = 0
        elif code in (Emergency.HEARTBEAT, Emergency.RPDO_TIMEOUT):
            self.alarms |= _WATCHDOG
        elif code & 0xFF00 == Emergency.SENSOR:
            self.alarms |= _ENCODER_FAULT

    def on_sdo(self, data: bytes) -> bool:
        """An SDO answer of 8 bytes; False where it is not one to the request that is open."""
        command, index, subindex, payload = cia301.SDO.unpack(data)
        if self._asked_tick < 0 or self.phase is not Phase.CONFIGURE:
            return False
        step = self._steps[self._step]
        if (index, subindex) != (step.object_index, step.subindex):
            return False
        if command == _ABORT:
            self._refuse(f"{index:04X}h:{subindex:02X} aborted with {int.from_bytes(payload, 'little'):#010x}")
        elif step.size:
            if command != _DOWNLOAD_ANSWER:
                return False
            self._next()
        else:
            if command & 0xF3 != _UPLOAD_ANSWER:
                return False
            self._check(step, int.from_bytes(payload[: 4 - (command >> 2 & 3)], "little"))
        return True

    def _check(self, step: Step, value: int) -> None:
        if value & step.mask == step.value:
            self._next()
        else:
            self._refuse(f"{step.object_index:04X}h = {value:#x}; expected {step.value:#x} in the bits {step.mask:#x}")

    def _next(self) -> None:
        self._asked_tick = -1
        self._step += 1
        if self._step == len(self._steps):
            self._enter(Phase.START)

    def _refuse(self, reason: str) -> None:
        self.problem = f"node {self.node_id}: {reason}"
        self._enter(Phase.REFUSED)

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._asked_tick = -1
        self._since_tick = self._tick

    # what it is told --------------------------------------------------------------------------------------------------

    def service(self, tick: int) -> Frame | None:
        """The frame that the node is due in this tick, if any."""
        self._tick = tick
        if self.phase is Phase.RUNNING:
            if tick - self._heard_tick > LOST_TICKS:
                self.restart()
            return None
        if self.phase is Phase.REFUSED:
            if tick - self._since_tick > RETRY_TICKS:
                self.restart()
            return None
        if self._asked_tick >= 0:
            return self._await(tick)
        self._asked_tick = tick
        if self.phase is Phase.START:
            return Frame(cia301.NMT_ID, bytes((NmtCommand.START, self.node_id)))
        return self._request(self._steps[self._step])

    def _await(self, tick: int) -> Frame | None:
        if tick - self._asked_tick <= SDO_TIMEOUT_TICKS:
            return None
        self._asked_tick = -1
        if self.phase is Phase.START:
            self.restart()  # it was started and sends no TPDO: perhaps it lost its configuration
            return None
        step = self._steps[self._step]
        code = Abort.TIMEOUT.to_bytes(4, "little")
        return self._frame(cia301.SDO.pack(_ABORT, step.object_index, step.subindex, code))

    def _request(self, step: Step) -> Frame:
        if not step.size:
            return self._frame(cia301.SDO.pack(_UPLOAD, step.object_index, step.subindex, bytes(4)))
        command = _DOWNLOAD | (4 - step.size) << 2
        value = step.value.to_bytes(4, "little")
        return self._frame(cia301.SDO.pack(command, step.object_index, step.subindex, value))

    def _frame(self, data: bytes) -> Frame:
        return Frame(cia301.SDO_REQUEST_ID + self.node_id, data)
