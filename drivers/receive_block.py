"""recvmmsg(2) into memory that is laid out once: one system call takes a whole tick's frames from a socket.

Python's own recvmsg_into costs one call per frame and one more to learn that there are none left; with the
ancillary data it builds each time that is half the I/O budget of a tick. Works for SocketCAN and for the AF_UNIX
links of the local bus alike: both deliver `struct can_frame` (16 B) or `struct canfd_frame` (72 B).
"""

import ctypes
import errno
import os
import socket
import struct
from collections.abc import Iterator

from drivers.frame_bytes import CANFD_MTU

SLOTS = 32  # messages per system call

SO_TIMESTAMPNS = 35  # <asm-generic/socket.h>; Python's socket module has no names for these two
SO_RXQ_OVFL = 40
STAMPED = socket.CMSG_SPACE(struct.calcsize("@ll"))  # control bytes of a message that has a time stamp

Result = tuple[int, int, int]
Contents = tuple[int, int, int, int, bytes, int, int, int, int]
PlainContents = tuple[int, int, int, bytes, int, int]


class _IoVec(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _MsgHdr(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint),
        ("iov", ctypes.c_void_p),
        ("iov_length", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _MMsgHdr(ctypes.Structure):
    _fields_ = (("header", _MsgHdr), ("received", ctypes.c_uint))


def _exactly(layout: str, size: int) -> struct.Struct:
    return struct.Struct(f"{layout}{size - struct.calcsize(layout)}x")


_CONTROL_BYTES = 64  # two control messages, 8-byte aligned behind the frame
_SLOT_BYTES = CANFD_MTU + _CONTROL_BYTES
_HEADER_BYTES = ctypes.sizeof(_MMsgHdr)

# control_length, flags, received: next to each other in struct mmsghdr but for padding
_GAP = _MMsgHdr.received.offset - _MsgHdr.flags.offset - ctypes.sizeof(ctypes.c_int)
_RESULT = _exactly(f"@{_MsgHdr.control_length.offset}xNi{_GAP}xI", _HEADER_BYTES)
# can_id, len, flags, reserved, data; then the control messages: SO_TIMESTAMPNS with seconds and nanoseconds,
# SO_RXQ_OVFL with its count. cmsg_len and cmsg_level are skipped, as only SOL_SOCKET messages have been asked for.
_CMSG = f"{struct.calcsize('@N') + 4}x"
_PLAIN = _exactly(f"@IBB2x64s{_CMSG}4xll", _SLOT_BYTES)
_CONTENTS = _exactly(f"@IBBH64s{_CMSG}ill{_CMSG}4xI", _SLOT_BYTES)

_DONT_WAIT = int(socket.MSG_DONTWAIT)
# PyDLL keeps the GIL: the call never waits, and handing the GIL over costs more than it takes.
_recvmmsg = ctypes.PyDLL(None, use_errno=True).recvmmsg
_recvmmsg.restype = ctypes.c_int  # no argtypes: plain ints are passed as C ints, which is quicker than converters


class ReceiveBlock:
    """Room for SLOTS messages, reused by every call."""

    def __init__(self, plain_size: int) -> None:
        """plain_size: of the messages that `plain` is for, CAN_MTU or CANFD_MTU."""
        self._headers = (_MMsgHdr * SLOTS)()
        self._vectors = (_IoVec * SLOTS)()
        self._memory = ctypes.create_string_buffer(SLOTS * _SLOT_BYTES)
        for index in range(SLOTS):
            frame = ctypes.addressof(self._memory) + index * _SLOT_BYTES
            self._vectors[index].base = frame
            self._vectors[index].length = CANFD_MTU
            header = self._headers[index].header
            header.iov = ctypes.addressof(self._vectors) + index * ctypes.sizeof(_IoVec)
            header.iov_length = 1
            header.control = frame + CANFD_MTU
            header.control_length = _CONTROL_BYTES
        self._address = ctypes.c_void_p(ctypes.addressof(self._headers))
        # Everything by the number of messages, so that a tick cuts nothing out of anything.
        headers, slots = memoryview(self._headers).cast("B"), memoryview(self._memory).cast("B")
        self._used = [headers[: count * _HEADER_BYTES] for count in range(SLOTS + 1)]
        self._slots = [slots[: count * _SLOT_BYTES] for count in range(SLOTS + 1)]
        self._fresh = [bytes(used) for used in self._used]  # the kernel overwrites control_length and flags
        for index in range(SLOTS):
            self._headers[index].header.control_length = STAMPED
            self._headers[index].received = plain_size
        self._plain = [bytes(used) for used in self._used]
        headers[:] = self._fresh[SLOTS]

    def receive(self, fd: int) -> int:
        """Take up to SLOTS queued messages; how many. Raises OSError as recvmsg(2) does, but returns 0 for none."""
        count: int = _recvmmsg(fd, self._address, SLOTS, _DONT_WAIT, None)
        if count < 0:
            number = ctypes.get_errno()
            if number == errno.EAGAIN:
                return 0
            raise OSError(number, os.strerror(number))
        return count

    def plain(self, count: int) -> Iterator[PlainContents] | None:
        """The `count` messages received last, as (can_id, length, flags, data, seconds, nanoseconds), oldest first.

        None unless all are of the plain size and have a time stamp and no flags: see `results` and `contents` then.

        It is the case in almost every tick, and one comparison is quicker than parsing. To be read, like `contents`,
        before the next call of `receive`.
        """
        used = self._used[count]
        if used.tobytes() != self._plain[count]:
            return None
        used[:] = self._fresh[count]
        return _PLAIN.iter_unpack(self._slots[count])

    def results(self, count: int) -> list[Result]:
        """Of the messages received last, oldest first: (control_length, flags, size).

        control_length: bytes of control messages (0: neither stamp nor count, STAMPED: a stamp, more: both). flags:
        MSG_CONFIRM and the like. size: bytes of the message (0: the other end has closed). To be asked for once.
        """
        used = self._used[count]
        results = list(_RESULT.iter_unpack(used))
        used[:] = self._fresh[count]
        return results

    def contents(self, count: int) -> Iterator[Contents]:
        """The messages received last, oldest first.

        (can_id, length, flags, reserved, data, kind, seconds, nanoseconds, dropped): `data` always has 64 bytes, of
        which those beyond the frame's are left over; CLOCK_REALTIME of arrival; what this socket has dropped so far.
        """
        return _CONTENTS.iter_unpack(self._slots[count])
