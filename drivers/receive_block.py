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

from drivers.frame import ECHO, ERROR, FD, FD_LENGTHS, Frame, new_tuple
from drivers.frame_bytes import CANFD_MTU

SLOTS = 32  # messages per system call

SO_TIMESTAMPNS = 35  # <asm-generic/socket.h>; Python's socket module has no names for these two
SO_RXQ_OVFL = 40
STAMPED = socket.CMSG_SPACE(struct.calcsize("@ll"))  # control bytes of a message that has a time stamp

Result = tuple[int, int, int]
Contents = tuple[int, int, int, int, bytes, int, int, int, int]
# The headers that some number of messages use; these when all are plain; when they are fresh; the messages' slots. No
# NamedTuple: only a true tuple is unpacked quickly.
Parts = tuple[memoryview, bytes, bytes, memoryview]


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
_HEAD = struct.Struct("@H")  # len and flags in one
_SECONDS = f"{struct.calcsize('@l')}x"
# can_id, head, data and the nanoseconds of the time stamp, by the length of the data
_ORDINARY = {
    length: _exactly(f"@IH2x{length}s{64 - length}x{_CMSG}4x{_SECONDS}l", _SLOT_BYTES).iter_unpack
    for length in FD_LENGTHS
}

_SECOND = 1_000_000_000
_DONT_WAIT = int(socket.MSG_DONTWAIT)
# PyDLL keeps the GIL: the call never waits, and handing the GIL over costs more than it takes.
_recvmmsg = ctypes.PyDLL(None, use_errno=True).recvmmsg
_recvmmsg.restype = ctypes.c_int  # no argtypes: plain ints are passed as C ints, which is quicker than converters


class ReceiveBlock:
    """Room for SLOTS messages, reused by every call.

    `frames` is the short way, for what almost every tick brings: frames of one length with nothing to tell but their
    data. Anything else is left to the long way, message by message: `results` and `contents`.
    """

    def __init__(self, size: int) -> None:
        """size: of the messages that the short way is for, CAN_MTU or CANFD_MTU."""
        self._mark = FD if size == CANFD_MTU else 0
        self.count = 0  # messages received last
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
        self._address = ctypes.byref(self._headers)  # quicker to pass than a c_void_p
        headers, slots = memoryview(self._headers).cast("B"), memoryview(self._memory).cast("B")
        fresh = bytes(headers)  # the kernel overwrites control_length and flags
        for index in range(SLOTS):
            self._headers[index].header.control_length = STAMPED
            self._headers[index].received = size
        plain = bytes(headers)
        headers[:] = fresh
        # Everything by the number of messages, so that a tick cuts nothing out of anything.
        self._parts: list[Parts] = []
        for count in range(SLOTS + 1):
            end = count * _HEADER_BYTES
            self._parts.append((headers[:end], plain[:end], fresh[:end], slots[: count * _SLOT_BYTES]))
        self.expect(0, 0)

    def expect(self, length: int, flags: int) -> None:
        """The short way is for frames of `length` data bytes with these raw flags, from now on."""
        unpack = _ORDINARY.get(length)
        if unpack is not None:
            self._unpack = unpack
            self._head: int = _HEAD.unpack(bytes((length, flags)))[0]
            self._flags = flags & ~ECHO | FD if self._mark else 0

    def receive(self, fd: int) -> int:
        """Take up to SLOTS queued messages; how many. Raises OSError as recvmsg(2) does, but returns 0 for none."""
        self.count = count = _recvmmsg(fd, self._address, SLOTS, _DONT_WAIT, None)
        if count < 0:
            self._fail()
        return self.count

    def _fail(self) -> None:
        self.count = 0
        number = ctypes.get_errno()
        if number != errno.EAGAIN:
            raise OSError(number, os.strerror(number))

    def frames(self, fd: int, offset_ns: int, earliest_ns: int, latest_ns: int) -> list[Frame] | None:
        """Take what is queued, oldest first, with its time stamp (CLOCK_REALTIME) less offset_ns.

        None where any of the `count` messages is out of the ordinary: of another size, length or flags than expected,
        an error frame, an own echo, a stamp missing or not within earliest_ns to latest_ns and the present second, a
        count of dropped frames with it; or SLOTS of them, as there may be more. They are then to be had from `results`
        and `contents`.
        Raises OSError as `receive` does.
        """
        self.count = count = _recvmmsg(fd, self._address, SLOTS, _DONT_WAIT, None)
        if not 0 < count < SLOTS:
            if count < 0:
                self._fail()
            return None if self.count else []
        used, plain, fresh, slots = self._parts[count]
        if used.tobytes() != plain or latest_ns - earliest_ns >= _SECOND:  # one comparison is quicker than parsing
            return None
        # The interval in nanoseconds of the present second: the stamps' own seconds need not be looked at then.
        last = (latest_ns + offset_ns) % _SECOND
        first = last - (latest_ns - earliest_ns)
        base_ns = latest_ns - last
        frames: list[Frame] = []
        # Local names and no call that can be saved: this is the innermost loop.
        expected, flags, error = self._head, self._flags, ERROR
        append, new, kind = frames.append, new_tuple, Frame
        for can_id, head, data, ns in self._unpack(slots):
            if head == expected and first <= ns <= last and (can_id < error or not can_id & error):
                append(new(kind, (can_id, data, flags, base_ns + ns)))
        if len(frames) != count:
            return None
        used[:] = fresh
        return frames

    def results(self) -> list[Result]:
        """Of the messages received last, oldest first: (control_length, flags, size).

        control_length: bytes of control messages (0: neither stamp nor count, STAMPED: a stamp, more: both). flags:
        MSG_CONFIRM and the like. size: bytes of the message (0: the other end has closed). To be asked for once.
        """
        used, _, fresh, _ = self._parts[self.count]
        results = list(_RESULT.iter_unpack(used))
        used[:] = fresh
        return results

    def contents(self) -> Iterator[Contents]:
        """The messages received last, oldest first.

        (can_id, length, flags, reserved, data, kind, seconds, nanoseconds, dropped): `data` always has 64 bytes, of
        which those beyond the frame's are left over; CLOCK_REALTIME of arrival; what this socket has dropped so far.
        """
        return _CONTENTS.iter_unpack(self._parts[self.count][3])
