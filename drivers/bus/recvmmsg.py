"""recvmmsg(2): one system call takes a whole tick's frames from a socket, into memory that is laid out once.

Python's own recvmsg_into costs one call per frame and one more to learn that there are none left; with the
ancillary data it builds each time that is half the I/O budget of a tick.
"""

import ctypes
import errno
import os
import socket
import struct
from collections.abc import Callable
from typing import Any, Final

from drivers.native import path as native

SLOTS: Final = 32  # messages per system call

SO_TIMESTAMPNS: Final = 35  # <asm-generic/socket.h>; Python's socket module has no names for these two
SO_RXQ_OVFL: Final = 40
STAMPED: Final = socket.CMSG_SPACE(struct.calcsize("@ll"))  # control bytes of a message that has a time stamp
CONTROL_BYTES: Final = 64  # two control messages, 8-byte aligned behind the frame


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


HEADER_BYTES: Final = ctypes.sizeof(_MMsgHdr)
# Of a header: where control_length is, and how much lies between flags and received.
CONTROL_LENGTH_AT: Final = _MsgHdr.control_length.offset
FLAGS_GAP: Final = _MMsgHdr.received.offset - _MsgHdr.flags.offset - ctypes.sizeof(ctypes.c_int)

DONT_WAIT: Final = int(socket.MSG_DONTWAIT)
# PyDLL keeps the GIL: the call never waits, and handing the GIL over costs more than it takes.
_recvmmsg: Final[Callable[[int, Any, int, int, None], int]] = ctypes.PyDLL(None, use_errno=True).recvmmsg
_recvmmsg.restype = ctypes.c_int  # type: ignore[attr-defined]  # no argtypes: plain ints pass quicker than converted ones


def _receive(fd: int, target: Any, slots: int) -> int:
    """Take up to `slots` messages into a memory's `target`; how many. Raises OSError as recvmsg(2) does, but returns 0
    for none.
    """
    count = _recvmmsg(fd, target, slots, DONT_WAIT, None)
    if count >= 0:
        return count
    number = ctypes.get_errno()
    if number != errno.EAGAIN:
        raise OSError(number, os.strerror(number))
    return 0


receive: Final[Callable[[int, Any, int], int]] = native.receive if native else _receive


class MessageMemory:
    """Room for SLOTS messages of at most `frame_bytes`, each with CONTROL_BYTES for control messages behind it.

    target: to give to `receive`, as long as this object lives. headers, slots: the bytes of all headers (HEADER_BYTES
    each) and of all messages. fresh: what the headers must be before each call, as the kernel overwrites control_length
    and flags. plain: what they are after a call that filled every slot with a message of `size` bytes and a time stamp,
    and had nothing else to tell.
    """

    def __init__(self, frame_bytes: int, size: int) -> None:
        slot_bytes = frame_bytes + CONTROL_BYTES
        self._headers = (_MMsgHdr * SLOTS)()
        self._vectors = (_IoVec * SLOTS)()
        self._memory = ctypes.create_string_buffer(SLOTS * slot_bytes)
        for index in range(SLOTS):
            frame = ctypes.addressof(self._memory) + index * slot_bytes
            self._vectors[index].base = frame
            self._vectors[index].length = frame_bytes
            header = self._headers[index].header
            header.iov = ctypes.addressof(self._vectors) + index * ctypes.sizeof(_IoVec)
            header.iov_length = 1
            header.control = frame + frame_bytes
            header.control_length = CONTROL_BYTES
        self.headers = memoryview(self._headers).cast("B")
        # quicker to pass than a c_void_p
        self.target: Any = self.headers if native else ctypes.byref(self._headers)
        self.slots = memoryview(self._memory).cast("B")
        self.fresh = bytes(self.headers)
        for index in range(SLOTS):
            self._headers[index].header.control_length = STAMPED
            self._headers[index].received = size
        self.plain = bytes(self.headers)
        self.headers[:] = self.fresh
