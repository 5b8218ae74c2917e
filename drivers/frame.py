"""One CAN or CAN FD frame, in the terms of Linux's can_frame and canfd_frame (include/uapi/linux/can.h)."""

import struct
from operator import attrgetter
from typing import Final, NamedTuple

EXTENDED: Final = 0x80000000  # CAN_EFF_FLAG, in can_id
REMOTE: Final = 0x40000000  # CAN_RTR_FLAG, in can_id
ERROR: Final = 0x20000000  # CAN_ERR_FLAG, in can_id: an error message frame, not traffic
STANDARD_MASK: Final = 0x7FF
EXTENDED_MASK: Final = 0x1FFFFFFF

BRS: Final = 0x01  # CANFD_BRS, in flags: data phase at the data bit rate
ESI: Final = 0x02  # CANFD_ESI, in flags: the sender is error-passive
FD: Final = 0x04  # CANFD_FDF, in flags: an FD frame
ECHO: Final = 0x80  # in flags, on no wire: an own frame given back by the bus, stamped with when it was out
SEGMENT: Final = 0x30  # in flags, on no wire: number of the rig's segment, 0 in a rig with one
_SEGMENT_SHIFT: Final = 4
MAX_SEGMENTS: Final = 4  # that SEGMENT can tell apart

FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


class Frame(NamedTuple):
    """A frame as it was received or is to be sent.

    can_id: 11- or 29-bit identifier, with EXTENDED, REMOTE and ERROR as Linux sets them.
    data: 0 to 8 bytes, or one of FD_LENGTHS for an FD frame. Of a remote frame only their number means something.
    flags: BRS, ESI, FD, ECHO, and the segment.
    timestamp_ns: reception time on the receiver's monotonic (or virtual) clock; 0 for a frame not yet sent.
    """

    can_id: int
    data: bytes
    flags: int = 0
    timestamp_ns: int = 0


CAN_MTU = 16  # sizeof(struct can_frame)
CANFD_MTU = 72  # sizeof(struct canfd_frame)

_CLASSIC = struct.Struct("=IB3x8s")  # can_id, len, padding and len8_dlc, data
_FD = struct.Struct("=IBB2x64s")  # can_id, len, flags, reserved, data
_pack_classic: Final = _CLASSIC.pack
_pack_fd: Final = _FD.pack
_FD_LENGTHS: Final = frozenset(FD_LENGTHS)


def segment_of(frame: Frame) -> int:
    """Number of the segment that the frame is on."""
    return (frame.flags & SEGMENT) >> _SEGMENT_SHIFT


def on_segment(frame: Frame, segment: int) -> Frame:
    """The same frame on that segment, from 0 to MAX_SEGMENTS - 1."""
    can_id, data, flags, stamp_ns = frame
    return Frame(can_id, data, flags & ~SEGMENT | segment << _SEGMENT_SHIFT, stamp_ns)


def sort_by_time(frames: list[Frame]) -> None:
    """The earliest received first; those of the same time stay as they are."""
    last_ns = 0
    for frame in frames:
        if frame.timestamp_ns < last_ns:  # mostly none is
            frames.sort(key=attrgetter("timestamp_ns"))
            return
        last_ns = frame.timestamp_ns


def to_bytes(frame: Frame) -> bytes:
    """Bytes to write to a CAN socket. Raises ValueError for a length that no frame can have."""
    can_id, data, flags, _ = frame
    length = len(data)
    if flags & FD:
        if length not in _FD_LENGTHS:
            raise ValueError(f"{length} data bytes: an FD frame has one of {FD_LENGTHS}")
        return _pack_fd(can_id, length, flags, data)
    if length > 8:
        raise ValueError(f"{length} data bytes: a classic frame has at most 8")
    return _pack_classic(can_id, length, data)


def from_bytes(packet: bytes, timestamp_ns: int = 0) -> Frame | None:
    """The frame in bytes read from a CAN socket; None where they are no frame (wrong size, impossible length)."""
    if len(packet) == CAN_MTU:
        can_id, length, data = _CLASSIC.unpack(packet)
        return Frame(can_id, data[:length], 0, timestamp_ns) if length <= 8 else None
    if len(packet) == CANFD_MTU:
        can_id, length, flags, data = _FD.unpack(packet)
        return Frame(can_id, data[:length], flags | FD, timestamp_ns) if length in _FD_LENGTHS else None
    return None
