"""DeviceProtocol of drives of the MIT kind: reads what the host tells them, without being one (sim_plant/drives)."""

from drivers.config import Wiring
from drivers.families.mit.layout import CODES, MIDDLE, MitLayout
from drivers.frame import EXTENDED, FD, Frame
from drivers.protocols.base import Command, Reject, Sample

_NODE = 0xFF


class MitListener(MitLayout):
    """force_resolution: half of a torque's step as a fraction of the least rated force."""

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        drives = self._drives
        steps = [2.0 * most / self._torque_codes for most in drives.torque]
        self.force_resolution = max(0.5 * step / rated for step, rated in zip(steps, self._rated, strict=True))
        self._axis = {node: axis for axis, node in enumerate(drives.nodes)}
        self._told = [(0.0, False, False)] * self.n_axes  # force, enabled, reset

    def decode_command(self, frame: Frame) -> Command | Reject:
        """The command that the last drive's frame completes; SERVICE for a part of one."""
        axis = self._axis.get(frame.can_id & _NODE, -1)
        if axis < 0 or not self._is_ours(frame.can_id, axis):
            return Reject.UNKNOWN_ID
        if frame.flags & FD:
            return Reject.WRONG_FORMAT
        if len(frame.data) != 8:
            return Reject.WRONG_LENGTH
        self._told[axis] = self._read(axis, frame)
        if axis < self.n_axes - 1:
            return Reject.SERVICE
        enable = sum(1 << axis for axis, (_, enabled, _) in enumerate(self._told) if enabled)
        return Command(0, [force for force, _, _ in self._told], enable, any(reset for _, _, reset in self._told))

    def _is_ours(self, can_id: int, axis: int) -> bool:
        node, packing = self._drives.nodes[axis], self._packing
        known = (packing.apply(node, 0), packing.start(node), packing.stop(node))
        return can_id & self.own_mask in {one.can_id & self.own_mask for one in known}

    def _read(self, axis: int, frame: Frame) -> tuple[float, bool, bool]:
        packing, node, most = self._packing, self._drives.nodes[axis], self._drives.torque[axis]
        start, clear, stop = packing.start(node), packing.clear(node), packing.stop(node)
        for order, enable, reset in ((start, True, False), (clear, False, True), (stop, False, False)):
            if (frame.can_id, frame.data) == (order.can_id, order.data):
                return 0.0, enable, reset
        raw = frame.can_id >> 8 & 0xFFFF if frame.can_id & EXTENDED else (frame.data[6] & 0xF) << 8 | frame.data[7]
        return raw / self._torque_codes * 2.0 * most - most, True, False

    def encode_feedback(self, sample: Sample) -> Frame:
        """The answer of one drive that means the same as the sample's status."""
        raw = max(1, min(CODES - 1, sample.position + MIDDLE))
        return self._packing.answer(self._drives.nodes[sample.axis], self.answer_ids[sample.axis], raw, sample.status)
