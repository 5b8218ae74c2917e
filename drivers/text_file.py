"""Files that somebody else wrote: read whole, but never more than such a file can be, and never from a pipe."""

import os
import stat
from pathlib import Path


class UnsuitableFileError(ValueError):
    """There is something of that name, but no file of the expected kind; the text says what."""


def read_bounded(path: str | os.PathLike[str], largest: int) -> bytes:
    """The bytes of a regular file. A pipe or a device is refused without waiting for anything.

    largest: bytes. Raises OSError where it cannot be read, UnsuitableFileError where it is no file or longer.
    """
    descriptor = os.open(Path(path), os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe without a writer would block
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise UnsuitableFileError("not a file but a pipe or device")
        data = file.read(largest + 1)
    if len(data) > largest:
        raise UnsuitableFileError(f"longer than {largest} bytes")
    return data
