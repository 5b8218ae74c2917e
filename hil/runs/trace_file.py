"""Recordings of a CAN bus in candump's format and those that python-can reads, of any program.

python-can's readers trust their file. Here their input is bounded instead: a regular file, lines and blocks no longer
than any writer makes them, a second for each frame. Whatever a reader raises on bytes of any kind becomes one error
that names the file. A frame that no bus can carry is an error, too.
"""

import gzip
import io
import math
import signal
import threading
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, cast

import can
from can.io.generic import BinaryIOMessageReader
from can.io.player import MESSAGE_READERS
from can.io.sqlite import SqliteReader

from drivers.base.text_file import open_untrusted, words_of
from drivers.base.toml_file import short
from drivers.frame import EXTENDED_MASK, STANDARD_MASK
from hil.runs.asc_log import read_asc
from hil.runs.busmaster_log import HEAD as BUSMASTER
from hil.runs.busmaster_log import read_busmaster
from hil.runs.candump_log import TraceError, read_log
from hil.runs.gvret_csv import HEAD as GVRET
from hil.runs.gvret_csv import read_gvret
from hil.runs.traces import suffix_of

LARGEST = 2**36  # bytes of a file: days of a full bus
LONGEST_LINE = 4096  # characters
LARGEST_BLOCK = 2**18  # bytes that are read at once, and that they unfold to; the blocks of a BLF file have 128 kB
FRAME_S = 1.0  # for one frame after another, whatever stands between them
_LATEST_S = 1e11  # beyond the year 5000
_CLASSIC_BYTES = 8  # of a frame that is no FD frame
_BEFORE_ZLIB = 16  # bytes of a BLF file's block before what is compressed
_OF_LINES = (".log", ".asc", ".csv", ".trc")
_SQL_STEPS = 10_000  # of SQLite's machine, between two looks at the clock


class _TooLongError(BaseException):
    """A frame took too long; no Exception, so that a reader does not catch it by accident."""


def read_trace(path: Path) -> Iterator[can.Message]:
    """The frames of a recording, error frames among them, in the order of the file. Raises TraceError."""
    count, at_s = 0, 0.0
    try:
        with _within_time() as soon, open_untrusted(path, LARGEST) as file:
            messages = soon(lambda: iter(_reader(path, file)))
            while (message := soon(lambda: next(messages, None))) is not None:
                message.is_fd |= len(message.data) > _CLASSIC_BYTES  # formats without the flag
                _refuse_impossible(message)
                count, at_s = count + 1, message.timestamp
                yield message
    except (Exception, _TooLongError) as error:  # of many kinds: the readers are not ours, and neither is the file
        words = short(words_of(error))
        place = f"after {count} frames, at {at_s:g} s: " if count else ""
        raise TraceError(f"{path}: {place}{words}") from None


def _reader(path: Path, file: BinaryIO) -> Iterable[can.Message]:
    suffix, folded = suffix_of(path), path.suffix.lower() == ".gz"
    content = cast(BinaryIO, gzip.GzipFile(fileobj=file)) if folded else file
    if suffix in _OF_LINES:
        return _of_lines(suffix, _Lines(content))
    made = MESSAGE_READERS[suffix]
    if issubclass(made, BinaryIOMessageReader) and suffix == ".blf":
        return made(cast(Any, _Blocks(content)))
    return _Database(path) if made is SqliteReader else made(path)


def _of_lines(suffix: str, lines: "_Lines") -> Iterable[can.Message]:
    """By the suffix, and by the first line where two programs have one suffix."""
    if suffix == ".log":
        return read_busmaster(lines) if lines.begins(BUSMASTER) else read_log(lines)
    if suffix == ".csv" and lines.begins(GVRET):
        return read_gvret(lines)
    return read_asc(lines) if suffix == ".asc" else cast(Any, MESSAGE_READERS[suffix])(lines)


class _Lines(io.TextIOBase):
    """A text file whose lines are not longer than LONGEST_LINE; what is no UTF-8 is replaced."""

    def __init__(self, content: BinaryIO) -> None:
        self._text = io.TextIOWrapper(content, encoding="utf-8", errors="replace")
        self._held: list[str] = []

    def begins(self, head: str) -> bool:
        """Whether the first line that is not blank does so; all are read again."""
        seen = [self.readline()]
        while seen[-1] == "\n":
            seen.append(self.readline())
        self._held = seen
        return seen[-1].removeprefix("\ufeff").startswith(head)

    def readable(self) -> bool:
        """See IOBase."""
        return True

    def readline(self, _size: int = -1) -> str:  # type: ignore[override]
        """The next line. Raises ValueError where it is too long."""
        line = self._held.pop(0) if self._held else self._text.readline(LONGEST_LINE + 1)
        if len(line) > LONGEST_LINE:
            raise ValueError(f"a line of more than {LONGEST_LINE} characters")
        return line


class _Blocks:
    """A binary file of which no more than LARGEST_BLOCK bytes are read at once, and which unfold to no more."""

    def __init__(self, content: BinaryIO) -> None:
        self._content = content

    def read(self, size: int) -> bytes:
        """The next bytes. Raises ValueError where they are too many."""
        if not 0 <= size <= LARGEST_BLOCK:
            raise ValueError(f"a block of {size} bytes: allowed up to {LARGEST_BLOCK}")
        data = self._content.read(size)
        if len(data) > _BEFORE_ZLIB:
            unfolded = b""
            with suppress(zlib.error):  # it is not compressed
                unfolded = zlib.decompressobj().decompress(data[_BEFORE_ZLIB:], LARGEST_BLOCK + 1)
            if len(unfolded) > LARGEST_BLOCK:
                raise ValueError(f"a block of {size} bytes that unfolds to more than {LARGEST_BLOCK}")
        return data

    def close(self) -> None:
        """Whoever opened it closes it."""


class _Database(SqliteReader):
    """Rows of bytes only, and no query that takes long: the table of an SQLite file may be a program."""

    def __iter__(self) -> Iterator[can.Message]:  # type: ignore[override]
        until = time.monotonic() + FRAME_S
        self._conn.setlimit(0, LARGEST_BLOCK)  # SQLITE_LIMIT_LENGTH, of a value
        self._conn.set_progress_handler(lambda: time.monotonic() > until, _SQL_STEPS)
        for row in self._cursor.execute(f"SELECT * FROM {self.table_name}"):
            if not isinstance(row[-1], bytes | None):
                raise ValueError(f"a frame whose data is {short(repr(row[-1]))}")
            yield self._assemble_message(row)
            until = time.monotonic() + FRAME_S


def _refuse_impossible(message: can.Message) -> None:
    """Raise ValueError for what no bus carries; a reader hands on whatever numbers it found."""
    if not (math.isfinite(message.timestamp) and abs(message.timestamp) <= _LATEST_S):
        raise ValueError(f"a frame at {message.timestamp} s")
    highest = EXTENDED_MASK if message.is_extended_id or message.is_error_frame else STANDARD_MASK
    if not 0 <= message.arbitration_id <= highest:
        raise ValueError(f"identifier {short(f'{message.arbitration_id:X}')}: allowed 0 to {highest:X}")
    longest = 64 if message.is_fd else _CLASSIC_BYTES
    if len(message.data) > longest:
        raise ValueError(f"a frame of {len(message.data)} bytes: at most {longest}")


@contextmanager
def _within_time() -> Iterator[Callable[[Callable[[], Any]], Any]]:
    """What calls a function and raises _TooLongError when it takes longer than FRAME_S.

    By a signal's timer, so in the main thread alone; elsewhere nothing limits the time.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda call: call()
        return

    def over(_number: int, _frame: object) -> None:
        raise _TooLongError(f"no frame within {FRAME_S:g} s of reading")

    def soon(call: Callable[[], Any]) -> Any:
        signal.setitimer(signal.ITIMER_REAL, FRAME_S)
        try:
            return call()
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)

    left, every = signal.setitimer(signal.ITIMER_REAL, 0.0)  # another's, as that of drivers/base/call_limit.py
    before = signal.signal(signal.SIGALRM, over)
    try:
        yield soon
    finally:
        signal.signal(signal.SIGALRM, before)
        signal.setitimer(signal.ITIMER_REAL, left, every)
