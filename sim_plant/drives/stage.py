"""What the drives of stage_fd and stage_classic hear and say, by the comments of the two DBC files alone.

Nothing here is shared with the layouts' own code (drivers/families/stage): where the two read the contract otherwise, a
run shows it.
"""

from collections.abc import Callable, Sequence
from struct import Struct
from typing import Any, ClassVar, Final
from zlib import crc32 as _crc32

import numpy as np

from drivers.frame import BRS, FD, Frame
from drivers.protocols.base import Command, Reject, Sample
from drivers.protocols.common import reject_id

crc32: Final = _crc32
AXES: Final = 4
FULL_SCALE: Final = 2047.0  # steps of the rated force, of stage_classic
DISABLED: Final = -2048
_FORCES = Struct("<4f")


class StageFdDrives:
    """Forces as single precision, of four axes in one command; CRC-32."""

    name = "stage_fd"
    fd = True
    sequence_modulus = 0x10000

    def __init__(self, host_id: int, feedback_id: int, rated_force: Sequence[float]) -> None:
        """rated_force: N, an axis each."""
        self.n_axes = len(rated_force)
        self._host_id, self._feedback_id = host_id, feedback_id
        # a rated force that was rounded up on its way is one still
        self._most = [float(np.float32(force)) for force in rated_force] + [0.0] * (AXES - self.n_axes)
        self._no_flags = ~((1 << self.n_axes) - 1 | 0x10) & 0xFFFF

    def decode_command(self, frame: Frame) -> Command | Reject:
        """The command in a received frame, or why there is none."""
        if frame.can_id != self._host_id:
            return reject_id(frame.can_id, (self._host_id,), -1)
        if not frame.flags & FD:
            return Reject.WRONG_FORMAT
        data = frame.data
        if len(data) != 24:
            return Reject.WRONG_LENGTH
        if crc32(data[:20], frame.can_id) != int.from_bytes(data[20:], "little"):
            return Reject.BAD_CHECKSUM
        flags = data[18] | data[19] << 8
        force = _FORCES.unpack_from(data)
        if flags & self._no_flags:
            return Reject.INVALID_VALUE
        for axis in range(AXES):
            if not abs(force[axis]) <= self._most[axis]:  # also where it is not a number
                return Reject.INVALID_VALUE
        return Command(data[16] | data[17] << 8, list(force[: self.n_axes]), flags & 0xF, flags & 0x10 != 0)

    def encode_feedback(self, sample: Sample) -> Frame:
        """One axis' answer."""
        can_id = self._feedback_id + sample.axis
        said = (
            (sample.position & 0xFFFF_FFFF).to_bytes(4, "little")
            + (sample.stamp_ns & 0xFFFF_FFFF).to_bytes(4, "little")
            + (sample.status & 0xFFFF | (sample.sequence & 0xFFFF) << 16).to_bytes(4, "little")
        )
        return Frame(can_id, said + crc32(said, can_id).to_bytes(4, "little"), FD | BRS)


class StageClassicDrives:
    """Torques in 1/2047 of the rated force, of four axes in eight bytes; CRC-8."""

    name = "stage_classic"
    fd = False
    sequence_modulus = 32
    force_resolution: ClassVar[float] = 0.5 / FULL_SCALE

    def __init__(self, host_id: int, feedback_id: int, rated_force: Sequence[float]) -> None:
        """rated_force: N, an axis each."""
        self.n_axes = len(rated_force)
        self._host_id, self._feedback_id = host_id, feedback_id
        self._rated = list(rated_force)
        self._bytes = _remainders()

    def _checksum(self, can_id: int, said: int) -> int:
        """CRC-8/AUTOSAR of the identifier and the lower seven bytes of a payload."""
        value = 0xFF
        value = self._bytes[value ^ can_id & 0xFF]
        value = self._bytes[value ^ can_id >> 8]
        for place in range(0, 56, 8):
            value = self._bytes[value ^ said >> place & 0xFF]
        return value ^ 0xFF

    def decode_command(self, frame: Frame) -> Command | Reject:
        """The command in a received frame, or why there is none."""
        if frame.can_id != self._host_id:
            return reject_id(frame.can_id, (self._host_id,), -1)
        if frame.flags & FD:
            return Reject.WRONG_FORMAT
        if len(frame.data) != 8:
            return Reject.WRONG_LENGTH
        said = int.from_bytes(frame.data[:7], "little")
        if self._checksum(frame.can_id, said) != frame.data[7]:
            return Reject.BAD_CHECKSUM
        if said >> 54:
            return Reject.INVALID_VALUE
        force, enable = [], 0
        for axis in range(AXES):
            steps = (said >> 12 * axis & 0xFFF ^ 0x800) - 0x800  # of two's complement
            if steps != DISABLED:
                if axis >= self.n_axes:
                    return Reject.INVALID_VALUE
                enable |= 1 << axis
            if axis < self.n_axes:
                force.append(0.0 if steps == DISABLED else steps * self._rated[axis] / FULL_SCALE)
        return Command(said >> 48 & 0x1F, force, enable, said >> 53 != 0)

    def encode_feedback(self, sample: Sample) -> Frame:
        """One axis' answer."""
        can_id = self._feedback_id + sample.axis
        microseconds = (sample.stamp_ns + 500) // 1000 & 0xFFF
        said = sample.position & 0xFFFF_FFFF | microseconds << 32
        said |= (sample.sequence & 0x1F | (sample.status & 0x7F) << 5) << 44
        return Frame(can_id, (said | self._checksum(can_id, said) << 56).to_bytes(8, "little"), 0)


def _remainders() -> list[int]:
    """Of every byte, divided by 0x12F."""
    found = []
    for value in range(256):
        rest = value << 8
        for place in range(15, 7, -1):
            if rest >> place & 1:
                rest ^= 0x12F << place - 8
        found.append(rest)
    return found


MADE: dict[str, Callable[..., Any]] = {"stage_fd": StageFdDrives, "stage_classic": StageClassicDrives}
