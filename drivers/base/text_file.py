"""Files that somebody else wrote: opened only where they are regular files, and never read beyond a stated size.

Everything that is read by a name which a person or another program gave goes through here. So a pipe, a device or a
file of any size is a refusal, and not a process that waits or fills the memory.
"""

import os
import stat
from pathlib import Path
from typing import BinaryIO

_KINDS = (
    (stat.S_ISDIR, "directory"),
    (stat.S_ISFIFO, "pipe"),
    (stat.S_ISSOCK, "socket"),
    (stat.S_ISCHR, "device"),
    (stat.S_ISBLK, "device"),
)


class UnsuitableFileError(ValueError):
    """There is something of that name, but no file of the expected kind; the text says what."""


def printable(text: str) -> str:
    """A text from elsewhere without what would command a terminal (ESC and its like); its lines stay."""
    return text if text.isprintable() else "".join(c if c.isprintable() or c == "\n" else "?" for c in text)


def words_of(error: BaseException) -> str:
    """Why something failed: in the system's words, in the exception's own, or else the kind of exception; never
    empty.
    """
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def open_untrusted(path: str | os.PathLike[str], largest: int) -> BinaryIO:
    """A regular file of at most `largest` bytes, open for reading; nothing is waited for.

    Raises OSError where it cannot be opened, UnsuitableFileError where it is something else or longer. A file may grow
    after that: a reader that wants it whole uses `read_bounded`.
    """
    place = Path(path)
    if "\0" in str(place):
        raise UnsuitableFileError("a name with a NUL in it")
    descriptor = os.open(place, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)  # a pipe would block
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            kind = next((name for applies, name in _KINDS if applies(found.st_mode)), "special file")
            raise UnsuitableFileError(f"not a file but a {kind}")
        if found.st_size > largest:
            raise UnsuitableFileError(f"longer than {largest} bytes")
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_bounded(path: str | os.PathLike[str], largest: int) -> bytes:
    """The bytes of a regular file. largest: bytes. Raises as `open_untrusted`."""
    with open_untrusted(path, largest) as file:
        data = file.read(largest + 1)  # files of /proc say that they have no bytes
    if len(data) > largest:
        raise UnsuitableFileError(f"longer than {largest} bytes")
    return data
