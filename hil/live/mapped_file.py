"""Files that processes share by mapping them: how a new one is laid out, opened by others, and closed.

A page is such a file of a fixed size whose first word says which kind it is.
"""

import mmap
import os
import struct
from abc import ABC, abstractmethod
from pathlib import Path
from types import TracebackType
from typing import Self

from drivers.base.runtime import create_private, open_private
from drivers.base.shared_map import map_shared, unmap


def lay_out(path: Path, size: int) -> tuple[int, Path]:
    """An open file of `size` zero bytes, private to this user, beside `path` under a temporary name; and that name.

    Every block is there: else a full file system would be a SIGBUS in some later tick. Who opens `path` never sees a
    half-made file, as the finished one is moved there. Raises OSError that names `path`.
    """
    temporary = path.with_name(f"{path.name}.{os.getpid()}.new")
    fd = create_private(temporary)
    try:
        os.posix_fallocate(fd, 0, size)
    except OSError as error:
        os.close(fd)
        temporary.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(path)) from None
    return fd, temporary


def create_page(path: Path, size: int, magic: int) -> None:
    """A new, empty page in place of any older one: nothing in it outlives the process it was meant for."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    fd, temporary = lay_out(path, size)
    try:
        os.pwrite(fd, struct.pack("<Q", magic), 0)
    finally:
        os.close(fd)
    os.replace(temporary, path)


def map_page(path: Path, size: int, magic: int, kind: str) -> tuple[int, mmap.mmap]:
    """The page at `path`, open and mapped. kind: for people. Raises ValueError where there is none of that kind."""
    try:
        fd = open_private(path, os.O_RDWR)
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from None
    if os.fstat(fd).st_size == size:
        page = map_shared(fd, size)
        if page[:8] == struct.pack("<Q", magic):
            return fd, page
        unmap(page)
    os.close(fd)
    raise ValueError(f"{path}: not a {kind}")


def replaced(path: Path, fd: int) -> bool:
    """Another file took the place of the open one under its path (a restarted control process)."""
    try:
        return os.stat(path).st_ino != os.fstat(fd).st_ino
    except FileNotFoundError:
        return True


class Closing(ABC):
    """Closed at the end of a `with` block, if not before."""

    @abstractmethod
    def close(self) -> None:
        """Close; idempotent."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
