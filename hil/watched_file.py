"""Has a file been changed since this process read it? Cheap enough to be asked by a real-time loop now and then."""

import hashlib
import os
from pathlib import Path


class WatchedFile:
    """One stat(2) per question; the file is read again (some kB) only when its inode, size or times have moved."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._digest = self._read()
        self._seen = self._stat()
        self._same = True

    def _stat(self) -> tuple[int, ...] | None:
        try:
            found = os.stat(self.path)
        except OSError:
            return None
        return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns

    def _read(self) -> bytes | None:
        try:
            return hashlib.sha256(self.path.read_bytes()).digest()
        except OSError:
            return None

    def unchanged(self) -> bool:
        """True while the content is what it was at the start; touching the file or writing it back does not matter."""
        seen = self._stat()
        if seen != self._seen:
            self._seen = seen
            self._same = seen is not None and self._read() == self._digest
        return self._same
