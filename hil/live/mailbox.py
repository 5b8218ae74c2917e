"""The mailbox: how commands reach the control process at next to no cost.

Rules:
- Senders (the sidecar's gateway; benchmarks and tests) post under a lock among themselves; the control process alone
  takes, and never waits for a sender.
- Nothing in the file, whatever its bytes, can raise in the control process.
- No command outlives the process it was meant for: each control process makes a new, empty mailbox.

Theory of operation: a small memory-mapped file of slots in a circle, with two counters, posted and taken, each written
by one side only and on a cache line of its own. A sender fills the slot, then raises `posted`: who sees the count sees
the command. A tick without mail costs one comparison of `posted` with the reader's own count. Each slot carries its
sequence number and a CRC: a torn or damaged slot is dropped and counted, and so is a count that no sender could have
reached. The file also carries a time (monotonic ns): when the recorder last gave a sign of life.
"""

import fcntl
import os
import struct
import zlib
from pathlib import Path
from typing import Final

from drivers.base.shared_map import shortened, unmap
from hil.cycle.record import MAX_COMMANDS
from hil.cycle.tick import CommandKind, OperatorCommand
from hil.live.mapped_file import Closing, create_page, map_page, replaced

MAGIC = 0x3130584F424C4948  # "HILBOX01"
SLOTS = 64
SLOT_SIZE = 64
FIRST_SLOT = 256
SIZE = FIRST_SLOT + SLOTS * SLOT_SIZE
RECORDER_TIMEOUT_NS: Final = 1_000_000_000  # the sidecar gives a sign of life 50 times a second

# u64 words; what senders write and what the control process writes lie on separate cache lines
_MAGIC: Final = 0
_POSTED: Final = 8
_RECORDER_NS: Final = 9
_TASK_POSTED: Final = 10  # number of the newest task that was sent (task_file.py)
_TAKEN: Final = 16
_DAMAGED: Final = 17
_TASK_READY: Final = 18  # number of the task that was taken in
_TASK_REFUSED: Final = 19  # number of one that was none

_COMMAND = struct.Struct("<QIIqI")  # sequence, kind, 0, expires_ns, CRC-32 of what precedes it
_BODY = _COMMAND.size - 4
_KINDS = {int(kind): kind for kind in CommandKind}
_NO_MAIL: Final[tuple[OperatorCommand, ...]] = ()


class MailboxError(Exception):
    """The mailbox is missing, is no mailbox, or is full."""


class Mailbox(Closing):
    """One end of the mailbox. The control process makes it with `create`; senders attach with `Mailbox(path)`."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        try:
            self._fd, self._map = map_page(self.path, SIZE, MAGIC, "mailbox")
        except ValueError as error:
            raise MailboxError(str(error)) from None
        self._words = memoryview(self._map).cast("Q")
        self._taken = self._words[_TAKEN]
        self._damaged = self._beat = self.mended = 0

    @classmethod
    def create(cls, path: str | os.PathLike[str]) -> "Mailbox":
        """A new, empty mailbox in place of any older one: no command outlives the process it was meant for."""
        path = Path(path)
        create_page(path, SIZE, MAGIC)
        return cls(path)

    # ---- the control process's end

    def poll(self) -> tuple[OperatorCommand, ...]:
        """Commands that arrived since the last call, oldest first, at most MAX_COMMANDS at a time. Never raises."""
        posted = self._words[_POSTED]
        if posted == self._taken:
            return _NO_MAIL
        return self._take(posted)

    def _take(self, posted: int) -> tuple[OperatorCommand, ...]:
        if not 0 < posted - self._taken <= SLOTS:  # no sender counts like this
            self._damage()
            self._taken = posted
        upto = min(posted, self._taken + MAX_COMMANDS)
        mail = tuple(command for index in range(self._taken, upto) if (command := self._read(index)))
        self._taken = upto
        self._words[_TAKEN] = upto
        return mail

    def _read(self, index: int) -> OperatorCommand | None:
        start = FIRST_SLOT + index % SLOTS * SLOT_SIZE
        sequence, kind, _, expires_ns, checksum = _COMMAND.unpack_from(self._map, start)
        known = _KINDS.get(kind)
        if known is None or sequence != index + 1 or checksum != zlib.crc32(self._map[start : start + _BODY]):
            self._damage()
            return None
        return OperatorCommand(known, sequence, expires_ns)

    def _damage(self) -> None:
        self._damaged += 1
        self._words[_DAMAGED] = self._damaged

    def recorder_ok(self, now_ns: int) -> bool:
        """The sidecar's recorder gave a sign of life within the last second."""
        beat = self._words[_RECORDER_NS]
        if beat != 0:  # else no recorder has begun, or the file was cut short: then the last sign counts
            self._beat = beat
        return 0 <= now_ns - self._beat < RECORDER_TIMEOUT_NS

    def mend(self) -> None:
        """Write head and counts anew where the file was cut short or overwritten: senders hold one count against the
        other, and with one of them lost they would find the box full for ever. Commands under way are lost.
        """
        if shortened(self._map) or self._words[_MAGIC] != MAGIC:
            self.mended += 1
            self._words[_POSTED] = self._words[_TAKEN] = self._taken
            self._words[_MAGIC] = MAGIC

    @property
    def task_posted(self) -> int:
        """Number of the newest task whose file was sent; 0: none was."""
        return self._words[_TASK_POSTED]

    def answer_task(self, number: int, *, ready: bool) -> None:
        """That task was taken in, or was none."""
        self._words[_TASK_READY if ready else _TASK_REFUSED] = number

    # ---- the senders' end

    def post_task(self, number: int) -> None:
        """The file of that task is there."""
        self._words[_TASK_POSTED] = number

    def task_ready(self, number: int) -> bool | None:
        """Whether that task was taken in; None: not yet known."""
        if self._words[_TASK_READY] == number:
            return True
        return False if self._words[_TASK_REFUSED] == number else None

    def post(self, kind: CommandKind, expires_ns: int) -> int:
        """Queue a command; returns its sequence number (1, 2, ...). Raises MailboxError when the box is full."""
        fcntl.flock(self._fd, fcntl.LOCK_EX)
        try:
            index = self._words[_POSTED]
            if index - self._words[_TAKEN] >= SLOTS:
                raise MailboxError(f"{SLOTS} commands are waiting already: the control process does not take them")
            body = struct.pack("<QIIq", index + 1, kind, 0, expires_ns)
            start = FIRST_SLOT + index % SLOTS * SLOT_SIZE
            self._map[start : start + _COMMAND.size] = body + struct.pack("<I", zlib.crc32(body))
            self._words[_POSTED] = index + 1  # after the slot: a reader that sees the count sees the command
            return index + 1
        finally:
            fcntl.flock(self._fd, fcntl.LOCK_UN)

    def beat_recorder(self, now_ns: int) -> None:
        """Sign of life of the recorder, monotonic ns."""
        self._words[_RECORDER_NS] = now_ns

    # ---- either end

    @property
    def damaged(self) -> int:
        """Slots or counts the control process found damaged."""
        return self._words[_DAMAGED]

    @property
    def replaced(self) -> bool:
        """Another mailbox took this one's place (a restarted control process)."""
        return replaced(self.path, self._fd)

    def close(self) -> None:
        """Unmap the file, which stays."""
        if not self._map.closed:
            self._words.release()
            unmap(self._map)
            os.close(self._fd)
