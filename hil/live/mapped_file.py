"""Files that processes share by mapping them: how a new one is laid out, and closed."""

import os
from abc import ABC, abstractmethod
from pathlib import Path
from types import TracebackType
from typing import Self

from drivers.runtime import create_private


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


class Closing(ABC):
    """Closed at the end of a `with` block, if not before."""

    @abstractmethod
    def close(self) -> None:
        """Close; idempotent."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
