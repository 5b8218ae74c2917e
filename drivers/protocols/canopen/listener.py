"""The cyclic part of cia402 as a DeviceProtocol: reads what the host tells the drives, without being one.

For monitors and tests. The drives themselves are CANopen nodes (sim_plant/drives/canopen_drive.py).
"""

from collections.abc import Sequence
from struct import Struct

from drivers.config import BusConfig
from drivers.frame import FD, Frame
from drivers.protocols.base import Command, DriveStatus, Reject, Sample
from drivers.protocols.canopen import cia301
from drivers.protocols.canopen.cia301 import DriveState
from drivers.protocols.canopen.host import rated_torque
from drivers.protocols.canopen.master import SERVICE_TICKS
from drivers.protocols.stage_common import reject_id

_WRAP, _HALF = 1 << 32, 1 << 31


class Cia402Listener:
    """DeviceProtocol of cia402. A command's enable bits are those of the last controlwords; it has no sequence (0).

    force_resolution: half of the coarsest axis' step as a fraction of its rated force. enable_lag: commands that may
    carry older enable bits than they would with bits of their own, as a controlword goes behind its tick's torques, and
    may have to wait for its turn.
    """

    name = "cia402"
    sequence_modulus = 0
    enable_lag = SERVICE_TICKS
    fd = False

    def __init__(self, bus: BusConfig, n_axes: int, rated_force: Sequence[float]) -> None:
        self.n_axes = n_axes
        self._first = bus.node_id
        self._units = [rated_torque(force) for force in rated_force]
        halves = [0.5e-6 * unit / force for (unit, _), force in zip(self._units, rated_force, strict=True)]
        self.force_resolution = max(halves)
        self._words = Struct(f"<{n_axes}H")
        self._torques = Struct(f"<{n_axes}h")
        self._feedback = Struct("<iH")
        self._controlwords = [0] * n_axes
        requests = {cia301.SDO_REQUEST_ID + bus.node_id + axis for axis in range(n_axes)}
        self._services = requests | {cia301.NMT_ID, cia301.SYNC_ID}

    def decode_command(self, frame: Frame) -> Command | Reject:
        """The command in the shared target torques; SERVICE for all else that the host says."""
        can_id, data, flags, _ = frame
        torques = cia301.RPDO1_ID + self._first
        words = (cia301.RPDO2_ID + self._first, cia301.RPDO3_ID + self._first)
        if can_id in self._services:
            return Reject.SERVICE
        if can_id != torques and can_id not in words:
            return reject_id(can_id, (torques, *words), -1)
        if flags & FD:
            return Reject.WRONG_FORMAT
        if len(data) != self._torques.size:
            return Reject.WRONG_LENGTH
        if can_id in words:
            self._controlwords = list(self._words.unpack(data))
            return Reject.SERVICE
        raw = self._torques.unpack(data)
        if any(abs(value) > limit for value, (_, limit) in zip(raw, self._units, strict=True)):
            return Reject.INVALID_VALUE
        force = [value * unit * 1e-6 for value, (unit, _) in zip(raw, self._units, strict=True)]
        enabled = [word & cia301.ENABLE_OPERATION == cia301.ENABLE_OPERATION for word in self._controlwords]
        reset = any(word & cia301.FAULT_RESET for word in self._controlwords)
        return Command(0, force, sum(1 << axis for axis, bit in enumerate(enabled) if bit), reset)

    def encode_feedback(self, sample: Sample) -> Frame:
        """TPDO 1 of one axis: position, and the statusword that means the same as the sample's status."""
        status = sample.status
        state = DriveState.SWITCHED_ON
        if status & (DriveStatus.FAULT | DriveStatus.WATCHDOG):
            state = DriveState.FAULT
        elif status & DriveStatus.ENABLED:
            state = DriveState.OPERATION_ENABLED
        word: int = state.value[1] | cia301.REMOTE
        word |= cia301.LIMIT_ACTIVE if status & DriveStatus.TORQUE_LIMITED else 0
        word |= cia301.HOMED if status & DriveStatus.HOMED else 0
        word |= cia301.BRAKE if status & DriveStatus.BRAKE else 0
        position = (sample.position + _HALF) % _WRAP - _HALF
        return Frame(cia301.TPDO1_ID + self._first + sample.axis, self._feedback.pack(position, word))
