"""The recording of one control process, in as many files as its length, full disks and restarts of the sidecar make.

Files: `run.mcap`, then `run.part-0002.mcap`, ...; `run-2.mcap` of the next control process in the same folder. No
tick is in two of them. What a full disk kept out is taken from the ring as soon as there is room again, as far as it is
still there.
"""

import contextlib
import itertools
import os
import re
import stat
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hil.live.ring import RingReader
from hil.rig.tables import TelemetryConfig
from hil.telemetry.codec import Records
from hil.telemetry.recorder import Recorder
from hil.telemetry.recording import Recording, RecordingError, part_path
from hil.telemetry.sidecar_progress import Progress

RETRY_NS = 1_000_000_000
HELD = 1024  # messages that wait for room
PASSING = frozenset({"status"})  # topics whose old messages are of no use
CAUGHT_UP = 512  # ticks taken from the ring at a time
BEHIND = 250  # ticks at once: of a sidecar that keeps up, a few tens
_OURS = re.compile(r"run(-\d+)?(\.part-\d+)?\.mcap")
_SNAPSHOTS = re.compile(r"(fault-|blackbox).*\.mcap")
SNAPSHOTS = 0.5  # of the quota, at most, for snapshots of faults and black boxes


class Limits(NamedTuple):
    """part_size, quota: bytes, of one file and of all that are kept. part_ns: longest time in one file."""

    part_size: int
    part_ns: int
    quota: int

    @classmethod
    def of(cls, config: TelemetryConfig) -> "Limits":
        """What a rig says."""
        return cls(config.record_part_size, round(config.record_part_s * 1e9), config.record_quota)


class Store(NamedTuple):
    """Where recordings go. folder: of this sidecar. kept_in: below which the quota counts. fixed: the folder was asked
    for, so that a predecessor's files elsewhere are not continued there.
    """

    folder: Path
    kept_in: Path
    fixed: bool


class RunRecorder:
    """Records what is in a ring, from where `progress` says that the recording on the disk ends, and keeps it current.

    save: keeps the progress for who takes over. Nothing raises for want of space: `errors` counts, `ok` is False until
    there is room, `problem` says why.
    """

    def __init__(
        self, store: Store, reader: RingReader, limits: Limits, progress: Progress, save: Callable[[Progress], None]
    ) -> None:
        self._store, self._reader, self._limits, self._progress, self._save = store, reader, limits, progress, save
        if not progress.recorded:
            _forget_unbegun(progress)
        if reader.written - reader.slots < progress.recorded:
            _cut_unnoted(progress)
        self._next = progress.recorded  # ring index of the tick that is to be taken next
        self._errors = 0  # of files given up
        self._retry_ns = self._began_ns = 0
        self._current: Recorder | None = None
        self.folder = store.folder
        if progress.file and not store.fixed and Path(progress.file).parent.is_dir():
            self.folder = Path(progress.file).parent
        self._held: deque[tuple[str, int, bytes]] = deque(maxlen=HELD)
        self._before = progress.file, progress.part  # the newest file
        self._over = self._in_trouble = False

    @property
    def ok(self) -> bool:
        """There is a file, and it is written."""
        return self._current is not None and self._current.ok

    @property
    def errors(self) -> int:
        """Files that could not be made or written to their end."""
        return self._errors + (self._current.errors if self._current else 0)

    @property
    def problem(self) -> str:
        """Why not `ok`."""
        return self._current.problem if self._current else ""

    @property
    def path(self) -> str:
        """The newest file."""
        return self._progress.file

    def take(self, records: Records, messages: Sequence[bytes], first: int) -> None:
        """Ticks that were just read, with their Tick messages; left to `keep_up` where others come before them."""
        if self._current is not None and self._current.ok and first == self._next:
            self._put(self._current, records, messages, first, 0)

    def _put(self, recorder: Recorder, records: Records, messages: Sequence[bytes], first: int, lost: int) -> None:
        recorder.hurried = len(records) > BEHIND
        recorder.ticks(records, messages, first=first, lost=lost)
        if recorder.ok:
            self._next = first + len(records)
        self._note()

    def _note(self) -> None:
        recorder = self._current
        if recorder is not None and recorder.size != self._progress.size and recorder.durable:
            self._progress.recorded, self._progress.size = recorder.durable, recorder.size
            self._save(self._progress)
        if recorder is not None and recorder.problem:
            if not recorder.durable:  # there is no such file
                self._progress.file, self._progress.part = self._before
            self._next = self._progress.recorded  # what was not whole is taken from the ring again
            if not self._in_trouble:
                print(f"recording: {recorder.path}: {recorder.problem}; trying again every second", flush=True)
            self._in_trouble = True

    def keep_up(self, upto: int, now_ns: int) -> bool:
        """One round: a new file where one is due, ticks before `upto` that are missing; False where there are none."""
        recorder = self._current
        if recorder is not None and recorder.ok:
            recorder.flush(now_ns)
            self._note()
            if recorder.size >= self._limits.part_size or now_ns - self._began_ns >= self._limits.part_ns:
                self._finish()
        if not self.ok and not self._over and now_ns >= self._retry_ns:
            self._open(now_ns)
        recorder = self._current
        if recorder is None or not recorder.ok or self._next >= upto:
            return False
        batch = self._reader.look(self._next, min(CAUGHT_UP, upto - self._next))
        if not len(batch.records):
            return False
        messages = list(recorder.encoder.encode(batch.records, batch.first))
        self._put(recorder, batch.records, messages, batch.first, batch.lost)
        return True

    def write(self, topic: str, time_ns: int, data: bytes) -> None:
        """Append a message of another topic; where no file is written, the newest HELD wait for one."""
        if self._current is not None and self._current.ok:
            self._current.write(topic, time_ns, data)
            self._note()
        elif topic not in PASSING:
            self._held.append((topic, time_ns, data))

    def _open(self, now_ns: int) -> None:
        self._errors = self.errors
        metadata: dict[str, Any] = {**self._reader.metadata, "run": f"{self._reader.run_id:016x}"}
        self._current = Recorder(self._new_path(), metadata | {"part": self._progress.part + 1})
        self._began_ns = now_ns
        if not self._current.ok:
            self._retry_ns = now_ns + RETRY_NS
            self._note()
            return
        if self._in_trouble:
            print(f"recording: goes on in {self._current.path}", flush=True)
        self._in_trouble = False
        self._before = self._progress.file, self._progress.part
        self._progress.part += 1
        self._progress.file = str(self._current.path.absolute())
        self._progress.size = 0
        self._save(self._progress)
        prune(self._store.kept_in, self._limits.quota, self._current.path)

    def _new_path(self) -> Path:
        """That of the next part; of a first one, a name that nothing has."""
        if self._progress.file:
            following = part_path(self.folder / Path(self._progress.file).name, self._progress.part + 1)
            if not following.exists():
                return following
        names = (self.folder / f"run{f'-{number}' if number > 1 else ''}.mcap" for number in itertools.count(1))
        return next(path for path in names if not os.path.lexists(path))

    def _finish(self) -> None:
        if self._current is not None:
            self._current.close()
            self._note()

    def close(self, upto: int, now_ns: int) -> None:
        """Take all before `upto` that can be taken, write index and summary; idempotent."""
        if not self._over:
            self._retry_ns = 0
            while self.keep_up(upto, now_ns):
                pass
            self._over = True
            self._finish()


def _cut_unnoted(progress: Progress) -> None:
    """Of a sidecar that was killed before it had noted its last chunk: remove that; the ring still has those ticks."""
    with contextlib.suppress(OSError):
        if 0 < progress.size < os.stat(progress.file).st_size:
            os.truncate(progress.file, progress.size)


def _forget_unbegun(progress: Progress) -> None:
    """Of a sidecar that was killed while it made its first file: remove what is no recording yet."""
    path = Path(progress.file)
    if progress.file and progress.part == 1 and path.is_file():
        try:
            Recording(path)
        except RecordingError:
            with contextlib.suppress(OSError):
                path.unlink()
                progress.file, progress.part = "", 0


def prune(folder: Path, quota: int, newest: Path) -> list[Path]:
    """Remove the oldest recordings of runs in a folder and the folders in it, until those that are left, with snapshots
    of faults and black boxes, have at most `quota` bytes.

    Of snapshots and black boxes the oldest go only where they alone have more than SNAPSHOTS of the quota. `newest`
    stays. Returns what was removed.
    """
    snapshots = _kept(folder, _SNAPSHOTS)
    removed = _thinned(snapshots, quota * SNAPSHOTS, newest)
    left = sum(size for _, size, path in snapshots if path not in removed)
    return removed + _thinned(_kept(folder, _OURS), quota - left, newest)


def _kept(folder: Path, pattern: re.Pattern[str]) -> list[tuple[int, int, Path]]:
    """(time, bytes, path) of the files with such names, the oldest first."""
    found: list[tuple[int, int, Path]] = []
    for path in (*folder.glob("*.mcap"), *folder.glob("*/*.mcap")):
        with contextlib.suppress(OSError):
            status = path.lstat()
            if pattern.fullmatch(path.name) and stat.S_ISREG(status.st_mode):
                found.append((status.st_mtime_ns, status.st_size, path))
    return sorted(found)


def _thinned(found: Sequence[tuple[int, int, Path]], quota: float, newest: Path) -> list[Path]:
    """Remove the oldest of them, but `newest`, until the rest has at most that many bytes; what was removed."""
    total = sum(size for _, size, _ in found)
    removed: list[Path] = []
    for _, size, path in found:
        if total <= quota:
            break
        if path.absolute() != newest.absolute():
            with contextlib.suppress(OSError):
                path.unlink()
                removed.append(path)
                total -= size
    return removed
