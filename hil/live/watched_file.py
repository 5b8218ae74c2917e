"""Has a file been changed since this process read it? Cheap enough to be asked by a real-time loop now and then."""

import hashlib
import os
import stat
from pathlib import Path

from drivers.base.text_file import UnsuitableFileError, read_bounded
from drivers.base.toml_file import LARGEST


class WatchedFile:
    """One stat(2) per question; the file is read again (some kB) only when its inode or times have moved, and its size
    has not. What takes its place, be it endless or a pipe that nobody writes to, holds nobody up.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._size, self._digest = self._read()
        self._seen = self._stat()
        self._same = True

    def _stat(self) -> tuple[int, ...] | None:
        try:
            found = os.stat(self.path)
        except OSError:
            return None
        return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns

    def _read(self) -> tuple[int, bytes]:
        """Bytes read and their digest; of nothing where a rig file cannot be so long, or it is no file."""
        try:
            content = read_bounded(self.path, LARGEST)
        except (OSError, UnsuitableFileError):
            return 0, b""
        return len(content), hashlib.sha256(content).digest()

    def unchanged(self) -> bool:
        """True while the content is what it was at the start; touching the file or writing it back does not matter."""
        seen = self._stat()
        if seen != self._seen:
            self._seen = seen
            self._same = self._still_there() and self._read() == (self._size, self._digest)
        return self._same

    def _still_there(self) -> bool:
        """A regular file of the same size."""
        try:
            found = os.stat(self.path)
        except OSError:
            return False
        return stat.S_ISREG(found.st_mode) and found.st_size == self._size
