"""The frames among the messages that recvmmsg(2) has received.

Works for SocketCAN and for the AF_UNIX links of the local bus alike: both deliver `struct can_frame` (16 B) or
`struct canfd_frame` (72 B).
"""

import struct
from collections.abc import Callable, Iterator
from typing import Final

from drivers.bus.recvmmsg import (
    CONTROL_BYTES,
    CONTROL_LENGTH_AT,
    FLAGS_GAP,
    HEADER_BYTES,
    SLOTS,
    MessageMemory,
    receive,
)
from drivers.frame import CANFD_MTU, ECHO, ERROR, FD, FD_LENGTHS, Frame
from drivers.native import path as native

Result = tuple[int, int, int]
Contents = tuple[int, int, int, int, bytes, int, int, int, int]
Ordinary = tuple[int, int, bytes, int]
# The headers that some number of messages use; these when all are plain; when they are fresh; the messages' slots. No
# NamedTuple: only a true tuple is unpacked quickly.
Parts = tuple[memoryview, bytes, bytes, memoryview]


def _exactly(layout: str, size: int) -> struct.Struct:
    return struct.Struct(f"{layout}{size - struct.calcsize(layout)}x")


_SLOT_BYTES: Final = CANFD_MTU + CONTROL_BYTES
# control_length, flags, received: next to each other in struct mmsghdr but for padding
_RESULT = _exactly(f"@{CONTROL_LENGTH_AT}xNi{FLAGS_GAP}xI", HEADER_BYTES)
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

_SECOND: Final = 1_000_000_000
_FRAME: Final = Frame
_STAMP_NS: Final = 1000


def stamp(time_ns: int) -> int:
    """A time as frames are stamped with it: cut to whole microseconds."""
    return time_ns - time_ns % _STAMP_NS


class ReceiveBlock:
    """What one system call received, at most SLOTS messages; reused by every call.

    `frames` is the fast path, for what almost every tick receives: frames of one length that carry nothing besides
    their data. Everything else takes the slow path, message by message: `results` and `contents`.
    """

    def __init__(self, size: int) -> None:
        """size: of the messages that the fast path is for, CAN_MTU or CANFD_MTU."""
        self._mark = FD if size == CANFD_MTU else 0
        self._size = size
        self.count = 0  # messages received last
        self._memory = memory = MessageMemory(CANFD_MTU, size)  # kept: `target` leads to all of it
        self._receive, self._target = receive, memory.target
        self._headers, self._slots = memory.headers, memory.slots
        self._native: Callable[..., list[Frame] | None] | None = native.frames if native else None
        # Everything by the number of messages, so that a tick cuts nothing out of anything.
        self._parts: list[Parts] = []
        for count in range(SLOTS + 1):
            end = count * HEADER_BYTES
            self._parts.append(
                (memory.headers[:end], memory.plain[:end], memory.fresh[:end], memory.slots[: count * _SLOT_BYTES])
            )
        self.expect(0, 0)

    def expect(self, length: int, flags: int) -> None:
        """From now on the fast path is for frames of `length` data bytes with these raw flags."""
        unpack = _ORDINARY.get(length)
        if unpack is not None:
            self._unpack: Callable[[memoryview], Iterator[Ordinary]] = unpack
            self._head: int = _HEAD.unpack(bytes((length, flags)))[0]
            self._flags = flags & ~ECHO | FD if self._mark else 0

    def receive(self, fd: int) -> int:
        """Take up to SLOTS queued messages; how many. Raises OSError as recvmsg(2) does, but returns 0 for none."""
        self.count = 0
        self.count = self._receive(fd, self._target, SLOTS)
        return self.count

    def frames(self, fd: int, offset_ns: int, earliest_ns: int, latest_ns: int) -> list[Frame] | None:
        """Take what is queued, oldest first, with its time stamp (CLOCK_REALTIME) less offset_ns, as `stamp`.

        None where the fast path is not for any of the `count` messages. Such are another size, length or flags than
        expected, an error frame, an own echo, and a count of dropped frames. So is a stamp that is missing, or not
        within earliest_ns to latest_ns and the present second; and SLOTS messages, as there may be more. Read them from
        `results` and `contents` then. Raises OSError as `receive` does.
        """
        count = self.receive(fd)
        if not 0 < count < SLOTS:
            return None if count else []
        if self._native is None:
            return self._plain_frames(count, offset_ns, earliest_ns, latest_ns)
        return self._native(
            self._headers, self._slots, count, _FRAME, self._size, self._head, self._flags,
            offset_ns, earliest_ns, latest_ns,
        )  # fmt: skip

    def _plain_frames(self, count: int, offset_ns: int, earliest_ns: int, latest_ns: int) -> list[Frame] | None:
        """The same in Python: of `count` messages, which are in the memory."""
        used, plain, fresh, slots = self._parts[count]
        if used.tobytes() != plain or latest_ns - earliest_ns >= _SECOND:  # one comparison is quicker than parsing
            return None
        # The interval in nanoseconds of the present second: the stamps' own seconds need not be looked at then.
        last = (latest_ns + offset_ns) % _SECOND
        first = last - (latest_ns - earliest_ns)
        base_ns = latest_ns - last
        frames: list[Frame] = []
        expected, flags = self._head, self._flags
        for can_id, head, data, ns in self._unpack(slots):
            if head == expected and first <= ns <= last and (can_id < ERROR or not can_id & ERROR):
                frames.append(Frame(can_id, data, flags, stamp(base_ns + ns)))
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
