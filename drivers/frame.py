"""One CAN or CAN FD frame, in the terms of Linux's can_frame and canfd_frame (include/uapi/linux/can.h)."""

from typing import Final, NamedTuple

# What a NamedTuple's constructor ends in, without its detour through Python: for the innermost loops.
new_tuple: Final = tuple.__new__

EXTENDED: Final = 0x80000000  # CAN_EFF_FLAG, in can_id
REMOTE: Final = 0x40000000  # CAN_RTR_FLAG, in can_id
ERROR: Final = 0x20000000  # CAN_ERR_FLAG, in can_id: an error message frame, not traffic
STANDARD_MASK: Final = 0x7FF
EXTENDED_MASK: Final = 0x1FFFFFFF

BRS: Final = 0x01  # CANFD_BRS, in flags: data phase at the data bit rate
ESI: Final = 0x02  # CANFD_ESI, in flags: the sender is error-passive
FD: Final = 0x04  # CANFD_FDF, in flags: an FD frame
ECHO: Final = 0x80  # in flags, on no wire: an own frame given back by the bus, stamped with when it was out

FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


class Frame(NamedTuple):
    """A frame as it was received or is to be sent.

    can_id: 11- or 29-bit identifier, with EXTENDED, REMOTE and ERROR as Linux sets them.
    data: 0 to 8 bytes, or one of FD_LENGTHS for an FD frame.
    flags: BRS, ESI, FD, ECHO.
    timestamp_ns: reception time on the receiver's monotonic (or virtual) clock; 0 for a frame not yet sent.
    """

    can_id: int
    data: bytes
    flags: int = 0
    timestamp_ns: int = 0
