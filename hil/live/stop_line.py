"""The control process' end of the stop page (hil/live/stop_page.py): made first, read every tick.

Its lock is also what keeps a second control process of the same rig from starting.
"""

import os
import struct
import time
from typing import Final

from drivers.base.runtime import open_private
from drivers.base.shared_map import map_shared, shortened, unmap
from hil.live.file_lock import try_lock, unlock
from hil.live.mapped_file import Closing
from hil.live.stop_page import (
    ALIVE_AT,
    INDEX,
    LATCHED_AT,
    LATCHED_INDEX,
    LATCHED_STATE,
    MAGIC,
    MAGIC_WORD,
    MENDED,
    NAME,
    NAME_BYTES,
    PID,
    PRESSED,
    SIZE,
    STATE,
)

_PRESSED: Final = PRESSED


class RigInUseError(Exception):
    """Another control process runs this rig; the text names it."""


class StopLine(Closing):
    """directory: the rig's own, private. Raises RigInUseError, or OSError naming the file that cannot be made."""

    def __init__(self, directory: str | os.PathLike[str]) -> None:
        self.path = os.path.join(directory, NAME)
        self._fd = _own(self.path)
        try:
            os.posix_fallocate(self._fd, 0, SIZE)  # else a full file system would be a SIGBUS in some later tick
            os.pwrite(self._fd, bytes(SIZE), 0)  # no press outlives the process it was meant for
            self._map = map_shared(self._fd, SIZE)
        except OSError as error:
            unlock(self._fd)
            raise OSError(error.errno, error.strerror, self.path) from None
        self._words = memoryview(self._map).cast("Q")
        self._seen = self.mended = 0
        self._write_head()

    def _write_head(self) -> None:
        self._words[PID] = os.getpid()
        self._words[MAGIC_WORD] = MAGIC

    def pressed(self) -> bool:
        """True once for every press since the last call. One comparison."""
        word = self._words[_PRESSED]
        if word == self._seen:
            return False
        self._seen = word
        return word != 0  # which no press writes: the file was cut short

    def tell(self, state: str, index: int) -> None:
        """A sign of life. state: its name. index: of the tick."""
        if shortened(self._map) or self._words[MAGIC_WORD] != MAGIC:  # or it was overwritten
            self.mended += 1
            self._write_head()
        self._write_state(STATE, state)
        self._words[INDEX] = index
        self._words[ALIVE_AT] = time.monotonic_ns()

    def tell_mended(self, others: int) -> None:
        """How often this file was mended, and others of the rig's."""
        self._words[MENDED] = self.mended + others

    def latched(self, state: str, index: int) -> None:
        """What the tick that read a press recorded."""
        self._write_state(LATCHED_STATE, state)
        self._words[LATCHED_INDEX] = index
        self._words[LATCHED_AT] = time.monotonic_ns()  # last: who waits for it finds the rest written
        self.tell(state, index)

    def _write_state(self, word: int, state: str) -> None:
        self._words[word], self._words[word + 1] = struct.unpack(
            "<2Q", state.encode()[:NAME_BYTES].ljust(NAME_BYTES, b"\0")
        )

    def close(self) -> None:
        """Unmap and unlock; the file stays. Idempotent."""
        if not self._map.closed:
            self._words.release()
            unmap(self._map)
            unlock(self._fd)


def _own(path: str) -> int:
    """A locked descriptor of the file at `path`, made where missing."""
    while True:
        fd = open_private(path, os.O_RDWR | os.O_CREAT)
        if not try_lock(fd):
            pid = struct.unpack("<Q", os.pread(fd, 8, 8 * PID).ljust(8, b"\0"))[0]
            unlock(fd)
            raise RigInUseError(f"{path}: another control process is running this rig (pid {pid})")
        try:
            if os.stat(path).st_ino == os.fstat(fd).st_ino:
                return fd
        except FileNotFoundError:
            pass
        unlock(fd)  # it was removed between the two calls
