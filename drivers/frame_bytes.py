"""A frame as the bytes of Linux's `struct can_frame` (16 B) or `struct canfd_frame` (72 B), in both directions."""

import struct
from typing import Final

from drivers.frame import FD, FD_LENGTHS, Frame

CAN_MTU = 16  # sizeof(struct can_frame)
CANFD_MTU = 72  # sizeof(struct canfd_frame)

_CLASSIC = struct.Struct("=IB3x8s")  # can_id, len, padding and len8_dlc, data
_FD = struct.Struct("=IBB2x64s")  # can_id, len, flags, reserved, data
_pack_classic: Final = _CLASSIC.pack
_pack_fd: Final = _FD.pack
_FD_LENGTHS: Final = frozenset(FD_LENGTHS)


def to_bytes(frame: Frame) -> bytes:
    """Bytes to write to a CAN socket. Raises ValueError for a length that no frame can have."""
    data, flags = frame.data, frame.flags
    length = len(data)
    if flags & FD:
        if length not in _FD_LENGTHS:
            raise ValueError(f"{length} data bytes: an FD frame has one of {FD_LENGTHS}")
        return _pack_fd(frame.can_id, length, flags, data)
    if length > 8:
        raise ValueError(f"{length} data bytes: a classic frame has at most 8")
    return _pack_classic(frame.can_id, length, data)


def from_bytes(packet: bytes, timestamp_ns: int = 0) -> Frame | None:
    """The frame in bytes read from a CAN socket; None where they are no frame (wrong size, impossible length)."""
    if len(packet) == CAN_MTU:
        can_id, length, data = _CLASSIC.unpack(packet)
        return Frame(can_id, data[:length], 0, timestamp_ns) if length <= 8 else None
    if len(packet) == CANFD_MTU:
        can_id, length, flags, data = _FD.unpack(packet)
        return Frame(can_id, data[:length], flags | FD, timestamp_ns) if length in _FD_LENGTHS else None
    return None
