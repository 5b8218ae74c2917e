"""The ring: how telemetry leaves the control process without ever making it wait.

Rules:
- The one writer never waits and never looks at readers. A reader that is too slow loses records, and is told how many.
- A reader never gets a record that the writer was changing while it was copied.
- The file outlives its writer: what a killed control process left is kept as `<path>.previous`, the black box.

Theory of operation: a memory-mapped file of fixed-size slots (hil.cycle.record). The writer copies each tick's record
into the next slot and then publishes a new write index. Readers copy slots out and then check, by the write index
before and after, which of them the writer may have overtaken meanwhile (a seqlock over the whole ring). The order
"record first, index second" relies on stores becoming visible in program order, as they do on x86-64. A lock that the
kernel drops with the process tells a living writer from a dead one, and an end mark tells a clean end from a killed
process.

Layout: one page of header, the metadata (JSON: rig, hash, version, platform) padded to pages, the slots.
"""

import contextlib
import json
import mmap
import os
import struct
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.base.runtime import open_private
from drivers.base.shared_map import map_shared, shortened, unmap
from drivers.native import copy
from hil.cycle.record import FRAME, MAX_RECEIVED, RECORD, RECORD_SIZE
from hil.live.file_lock import is_locked, try_lock, unlock
from hil.live.mapped_file import Closing, lay_out, replaced

MAGIC = b"HILRING1"
VERSION = 4  # of header and record
PAGE = 4096
_HEADER = struct.Struct("<8sIIQQQQQQq")  # see _Header

_copy: Final = copy
_WRITE_INDEX: Final = 128 // 8  # u64 words of the header, on cache lines of their own
_ENDED = 192 // 8
_CLEAN, _SAVED = 1, 2  # values of _ENDED

_FIRST_RECEIVED: Final = RECORD.fields["received"][1]  # type: ignore[index]
_N_RECEIVED: Final[int] = RECORD.fields["n_received"][1] // 2  # type: ignore[index]  # as an index of u16
_USED: Final = tuple(_FIRST_RECEIVED + FRAME.itemsize * n for n in range(MAX_RECEIVED + 1))


class RingError(Exception):
    """The ring file is missing, not a ring, or in use by another control process."""


class _Header(NamedTuple):
    magic: bytes
    version: int
    record_size: int
    slots: int
    data_offset: int
    metadata_length: int
    period_ns: int
    pid: int
    run_id: int  # differs between any two rings
    started_ns: int  # wall clock, for people


class Batch(NamedTuple):
    """Records in order, each a copy; `first`: ring index of the first; `lost`: overwritten before being read."""

    records: NDArray[np.void]
    first: int
    lost: int


def previous_path(path: Path) -> Path:
    """Where the ring of a control process that did not end cleanly is kept."""
    return path.with_name(path.name + ".previous")


class RingWriter(Closing):
    """The control process's end of the ring.

    path: file to create (its directory is created, private). slots: ticks kept, >= 2. metadata: the run, JSON-able.
    Raises RingError while another living process writes there, OSError when the file system has no room.
    """

    def __init__(
        self, path: str | os.PathLike[str], slots: int, *, period_ns: int = 0, metadata: dict[str, Any] | None = None
    ) -> None:
        if slots < 2:
            raise ValueError(f"slots = {slots}: a ring needs at least 2")
        self.path = Path(path)
        self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._fd, self._map = _create(self.path, slots, period_ns, json.dumps(metadata or {}).encode())
        header = _Header(*_HEADER.unpack_from(self._map))
        self.run_id = header.run_id
        self._view = memoryview(self._map)
        self._words = self._view.cast("Q")
        self._slots = self._view[header.data_offset :]
        self._size = slots * RECORD_SIZE
        self._offset = 0
        self.written = self.mended = 0
        self._head = bytes(self._map[: header.data_offset])
        self._record: np.void | None = None
        self._sources: list[memoryview] = []  # the bytes in use, by the number of frames received
        self._counts = memoryview(b"")

    def append(self, record: np.void) -> None:
        """Copy one record (dtype RECORD) into the ring. Never waits; cheapest when the object is reused."""
        if record is not self._record:
            self._bind(record)
        # Slots beyond the frames received keep what they held; readers go by n_received.
        used = self._sources[self._counts[_N_RECEIVED]]
        start = self._offset
        _copy(self._slots, start, used)
        start += RECORD_SIZE
        self._offset = start if start < self._size else 0
        self.written += 1
        self._words[_WRITE_INDEX] = self.written

    def mend(self) -> None:
        """Write the head anew where the file was cut short or overwritten; what slots held is lost."""
        if shortened(self._map) or self._map[: len(MAGIC)] != MAGIC:
            self.mended += 1
            self._map[: len(self._head)] = self._head
            self._words[_WRITE_INDEX] = self.written

    def _bind(self, record: np.void) -> None:
        source = np.frombuffer(record, np.uint8).data
        self._sources = [source[:used] for used in _USED]
        self._counts = source.cast("H")
        self._record = record

    def close(self) -> None:
        """Mark a clean end and close; the file stays."""
        if not self._map.closed:
            self._words[_ENDED] = _CLEAN
            self._record = None
            for view in (self._words, self._slots, self._view):
                view.release()
            unmap(self._map)
            unlock(self._fd)


def _create(path: Path, slots: int, period_ns: int, metadata: bytes) -> tuple[int, mmap.mmap]:
    """A new ring under a temporary name, locked, then put in the old one's place."""
    data_offset = PAGE + -(-len(metadata) // PAGE) * PAGE
    size = data_offset + slots * RECORD_SIZE
    fd, temporary = lay_out(path, size)
    try:
        ring = map_shared(fd, size)
        run_id = int.from_bytes(os.urandom(8), "little")
        header = _Header(
            MAGIC,
            VERSION,
            RECORD_SIZE,
            slots,
            data_offset,
            len(metadata),
            period_ns,
            os.getpid(),
            run_id,
            time.time_ns(),
        )
        _HEADER.pack_into(ring, 0, *header)
        ring[PAGE : PAGE + len(metadata)] = metadata
        try_lock(fd)
        _replace(path, temporary)
    except BaseException:
        unlock(fd)
        temporary.unlink(missing_ok=True)
        raise
    return fd, ring


def _replace(path: Path, temporary: Path) -> None:
    """Move `temporary` to `path`, keeping a killed writer's ring as the black box. Raises RingError if one lives."""
    while True:
        try:
            old = open_private(path, os.O_RDWR)
        except FileNotFoundError:
            with contextlib.suppress(FileExistsError):
                os.link(temporary, path)
                temporary.unlink()
                return
            continue  # another writer was faster
        try:
            if not try_lock(old):
                raise RingError(f"{path}: another control process is running this rig (pid {_pid(old)})")
            with contextlib.suppress(FileNotFoundError):
                if os.stat(path).st_ino == os.fstat(old).st_ino:
                    if _died(old):
                        os.replace(path, previous_path(path))
                    os.replace(temporary, path)
                    return
        finally:
            unlock(old)


def _pid(fd: int) -> int:
    return _Header(*_HEADER.unpack(os.pread(fd, _HEADER.size, 0))).pid


def _died(fd: int) -> bool:
    page = os.pread(fd, PAGE, 0)
    if len(page) < PAGE or page[: len(MAGIC)] != MAGIC:
        return False
    words = memoryview(page).cast("Q")
    return words[_WRITE_INDEX] > 0 and words[_ENDED] == 0


class RingReader(Closing):
    """A reader's end of the ring; starts at the oldest record that is still there.

    Raises RingError when the file is missing or is no ring of this version.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        try:
            self._fd = open_private(self.path, os.O_RDWR)  # asking for the write lock needs it
        except OSError as error:
            raise RingError(f"{self.path}: {error.strerror}") from None
        try:
            self._map = self._map_whole()
        except (RingError, ValueError, OSError) as error:
            os.close(self._fd)
            raise RingError(f"{self.path}: {error}") from None
        self._words = np.frombuffer(self._map, np.uint64, PAGE // 8)
        self._slots = np.frombuffer(self._map, RECORD, self.slots, self._header.data_offset)
        self.next = 0

    def _map_whole(self) -> mmap.mmap:
        raw = os.pread(self._fd, _HEADER.size, 0)
        if len(raw) < _HEADER.size or raw[: len(MAGIC)] != MAGIC:
            raise RingError("not a telemetry ring")
        self._header = header = _Header(*_HEADER.unpack(raw))
        if (header.version, header.record_size) != (VERSION, RECORD_SIZE):
            raise RingError(
                f"version {header.version}, records of {header.record_size} B; expected {VERSION}, {RECORD_SIZE} B"
            )
        size = header.data_offset + header.slots * RECORD_SIZE
        if os.fstat(self._fd).st_size < size:
            raise RingError("truncated")
        self.slots, self.period_ns, self.pid, self.run_id = header.slots, header.period_ns, header.pid, header.run_id
        self.started_ns = header.started_ns
        return map_shared(self._fd, size, mmap.PROT_READ)

    @property
    def metadata(self) -> dict[str, Any]:
        """What the writer said about its run."""
        text: dict[str, Any] = json.loads(self._map[PAGE : PAGE + self._header.metadata_length])
        return text

    @property
    def written(self) -> int:
        """Records published so far."""
        return int(self._words[_WRITE_INDEX])

    @property
    def ended(self) -> bool:
        """The writer said that it ended cleanly."""
        return bool(self._words[_ENDED] == _CLEAN)

    @property
    def saved(self) -> bool:
        """The writer was killed, and what it left is in a recording."""
        return bool(self._words[_ENDED] == _SAVED)

    def mark_saved(self) -> None:
        """Note in a killed writer's ring that a recording holds it: it is no black box any more."""
        if not self.ended and not self.writer_alive:
            os.pwrite(self._fd, struct.pack("<Q", _SAVED), _ENDED * 8)

    @property
    def writer_alive(self) -> bool:
        """The writing process exists and has the ring open."""
        return is_locked(self._fd)

    @property
    def replaced(self) -> bool:
        """Another ring took this one's place under the path (a restarted control process)."""
        return replaced(self.path, self._fd)

    def read(self, limit: int = 512, fields: Sequence[str] = ()) -> Batch:
        """Copy out up to `limit` records that were not read before. Never blocks; the batch may be empty.

        fields: of the records, all if none is named; a few cost a thirtieth.
        """
        batch = self.look(self.next, limit, fields)
        self.next = batch.first + len(batch.records)
        return batch

    def look(self, first: int, limit: int = 512, fields: Sequence[str] = ()) -> Batch:
        """The same from ring index `first` on, whatever was read before; `read` goes on where it was."""
        written = self.written
        oldest = max(written - self.slots + 1, 0)
        lost = max(oldest - first, 0)
        first += lost
        count = max(min(written - first, limit), 0)
        records = self._copy(np.arange(first, first + count) % self.slots, fields)
        # Record i is safe unless the writer may have begun its slot again, once i + slots records are published.
        overtaken = min(max(self.written - self.slots + 1 - first, 0), count)
        return Batch(records[overtaken:], first + overtaken, lost + overtaken)

    def _copy(self, slots: NDArray[np.int64], fields: Sequence[str]) -> NDArray[np.void]:
        if not fields:
            return self._slots[slots]  # fancy indexing copies
        records = np.empty(len(slots), [(field, RECORD[field]) for field in fields])
        for field in fields:
            records[field] = self._slots[field][slots]
        return records

    def close(self) -> None:
        """Unmap the file."""
        if self._fd >= 0:
            self._words, self._slots = self._words[:0].copy(), self._slots[:0].copy()  # nothing may hold the map
            unmap(self._map)
            os.close(self._fd)
            self._fd = -1
