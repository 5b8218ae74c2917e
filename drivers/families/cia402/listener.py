"""The cyclic part of cia402 as a DeviceProtocol: reads what the host tells the drives, without being one.

For monitors and tests. The drives themselves are CANopen nodes (sim_plant/drives/canopen_drive.py).
"""

from struct import Struct

from drivers.config import Wiring
from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import DriveState
from drivers.families.cia402.host import node_ids, plan_rig
from drivers.families.cia402.master import SERVICE_TICKS
from drivers.frame import FD, Frame
from drivers.protocols.base import Command, DriveStatus, LayoutError, Reject, Sample
from drivers.protocols.common import reject_id

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

    def __init__(self, wiring: Wiring) -> None:
        bus, n_axes, rated_force, _, base_dir = wiring
        self.n_axes = n_axes
        nodes = node_ids(bus, n_axes)
        plans = plan_rig(bus, rated_force, base_dir, period_ns=0)
        self._units, self._limits = [], []
        for axis, plan in enumerate(plans):
            if plan.unit is None:
                raise LayoutError(f"bus.cia402.rated_torque: axis {axis}'s is needed to read its torques off the bus")
            self._units.append(plan.unit)
            self._limits.append(plan.limit)
        halves = [0.5e-6 * unit / force for unit, force in zip(self._units, rated_force, strict=True)]
        self.force_resolution = max(halves)
        self._shared = plans[0].shared
        first = nodes[0]
        self._torque_ids = [cia301.RPDO1_ID + node for node in (nodes[:1] if self._shared else nodes)]
        self._word_ids = [cia301.RPDO2_ID + first, cia301.RPDO3_ID + first] if self._shared else []
        self._layouts = {can_id: Struct(f"<{n_axes}h" if self._shared else "<Hh") for can_id in self._torque_ids}
        self._layouts |= {can_id: Struct(f"<{n_axes}H") for can_id in self._word_ids}
        self._feedback = Struct("<iH")
        self._feedback_ids = [cia301.TPDO1_ID + node for node in nodes]
        self._controlwords = [0] * n_axes
        self._torques = [0] * n_axes
        self._services = {cia301.SDO_REQUEST_ID + node for node in nodes} | {cia301.NMT_ID, cia301.SYNC_ID}

    def decode_command(self, frame: Frame) -> Command | Reject:
        """The command that the last frame with torques completes; SERVICE for all else that the host says."""
        can_id, data, flags, _ = frame
        layout = self._layouts.get(can_id)
        if layout is None:
            return Reject.SERVICE if can_id in self._services else reject_id(can_id, self._layouts, -1)
        if flags & FD:
            return Reject.WRONG_FORMAT
        if len(data) != layout.size:
            return Reject.WRONG_LENGTH
        values = layout.unpack(data)
        if can_id in self._word_ids:
            self._controlwords = list(values)
            return Reject.SERVICE
        if self._shared:
            self._torques = list(values)
        else:
            axis = self._torque_ids.index(can_id)
            self._controlwords[axis], self._torques[axis] = values
            if can_id != self._torque_ids[-1]:
                return Reject.SERVICE
        if any(abs(value) > limit for value, limit in zip(self._torques, self._limits, strict=True)):
            return Reject.INVALID_VALUE
        force = [value * unit * 1e-6 for value, unit in zip(self._torques, self._units, strict=True)]
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
        return Frame(self._feedback_ids[sample.axis], self._feedback.pack(position, word))
