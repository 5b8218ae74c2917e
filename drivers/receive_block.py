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
from collections.abc import Iterable

from drivers.frame_bytes import CANFD_MTU

SLOTS = 32  # messages per system call

SO_TIMESTAMPNS = 35  # <asm-generic/socket.h>; Python's socket module has no names for these two
SO_RXQ_OVFL = 40
STAMPED = socket.CMSG_SPACE(struct.calcsize("@ll"))  # control bytes of a message that has a time stamp

Result = tuple[int, int, int]
Contents = tuple[int, int, int, int, bytes, int, int, int, int]
Packets = Iterable[tuple[Result, Contents]]


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
_CONTENTS = _exactly(f"@IBBH64s{_CMSG}ill{_CMSG}4xI", _SLOT_BYTES)

_DONT_WAIT = int(socket.MSG_DONTWAIT)
_recvmmsg = ctypes.CDLL(None, use_errno=True).recvmmsg
_recvmmsg.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p)
_recvmmsg.restype = ctypes.c_int


class ReceiveBlock:
    """Room for SLOTS messages, reused by every call."""

    def __init__(self) -> None:
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
        self._slots = memoryview(self._memory).cast("B")
        self._header_view = memoryview(self._headers).cast("B")
        self._fresh = bytes(self._header_view)  # the kernel overwrites control_length and flags
        self._address = ctypes.addressof(self._headers)

    def receive(self, fd: int) -> tuple[int, Packets]:
        """Take up to SLOTS queued messages, oldest first: how many, and each as (result, contents).

        result: (control_length, flags, size): bytes of control messages (0: neither stamp nor count, STAMPED: a stamp,
        more: both), MSG_CONFIRM and the like, bytes of the message (0: the other end has closed).
        contents: (can_id, length, flags, reserved, data, kind, seconds, nanoseconds, dropped): `data` always has 64
        bytes, of which those beyond the frame's are left over; CLOCK_REALTIME of arrival; what this socket has dropped.
        Raises OSError as recvmsg(2) does, except that nothing there is no error. Read it all before the next call.
        """
        count = _recvmmsg(fd, self._address, SLOTS, _DONT_WAIT, None)
        if count < 0:
            number = ctypes.get_errno()
            if number == errno.EAGAIN:
                return 0, ()
            raise OSError(number, os.strerror(number))
        used = count * _HEADER_BYTES
        results = list(_RESULT.iter_unpack(self._header_view[:used]))
        self._header_view[:used] = self._fresh[:used]
        contents = _CONTENTS.iter_unpack(self._slots[: count * _SLOT_BYTES])
        return count, zip(results, contents, strict=True)  # type: ignore[arg-type]
