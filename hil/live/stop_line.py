"""The control process' end of the stop page (hil/live/stop_page.py): made first, read every tick.

Its lock is also what keeps a second control process of the same rig from starting.
"""

import mmap
import os
import struct
import time
from typing import Final

from drivers.runtime import open_private
from hil.live.file_lock import try_lock
from hil.live.mapped_file import Closing
from hil.live.stop_page import (
    ALIVE_AT,
    INDEX,
    LATCHED_AT,
    LATCHED_INDEX,
    LATCHED_STATE,
    MAGIC,
    MAGIC_WORD,
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
            self._map = mmap.mmap(self._fd, SIZE, mmap.MAP_SHARED | mmap.MAP_POPULATE)
        except OSError as error:
            os.close(self._fd)
            raise OSError(error.errno, error.strerror, self.path) from None
        self._words = memoryview(self._map).cast("Q")
        self._words[PID] = os.getpid()
        self._words[MAGIC_WORD] = MAGIC
        self._seen = 0

    def pressed(self) -> bool:
        """True once for every press since the last call. One comparison."""
        word = self._words[_PRESSED]
        if word == self._seen:
            return False
        self._seen = word
        return True

    def tell(self, state: str, index: int) -> None:
        """A sign of life. state: its name. index: of the tick."""
        self._write_state(STATE, state)
        self._words[INDEX] = index
        self._words[ALIVE_AT] = time.monotonic_ns()

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
            self._map.close()
            os.close(self._fd)


def _own(path: str) -> int:
    """A locked descriptor of the file at `path`, made where missing."""
    while True:
        fd = open_private(path, os.O_RDWR | os.O_CREAT)
        if not try_lock(fd):
            pid = struct.unpack("<Q", os.pread(fd, 8, 8 * PID).ljust(8, b"\0"))[0]
            os.close(fd)
            raise RigInUseError(f"{path}: another control process is running this rig (pid {pid})")
        try:
            if os.stat(path).st_ino == os.fstat(fd).st_ino:
                return fd
        except FileNotFoundError:
            pass
        os.close(fd)  # it was removed between the two calls
