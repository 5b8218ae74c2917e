"""Files that are written, and their errors with the file's name, as a full disk's do not have it."""

from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any


@contextmanager
def naming(path: str | PathLike[str]) -> Iterator[None]:
    """Within this, an OSError without a file's name gets that of `path`: `write` knows a number only."""
    try:
        yield
    except OSError as error:
        if error.filename is not None or error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


def write_text(path: str | PathLike[str], text: str) -> None:
    """Write a whole file in UTF-8; bytes that `surrogateescape` kept come out as they were. Raises OSError with the
    file's name.
    """
    with naming(path):
        Path(path).write_text(text, encoding="utf-8", errors="surrogateescape")


def save_picture(figure: Any, path: Path, dpi: int = 120, **more: Any) -> None:
    """Write a figure of matplotlib; its folder is made. Raises OSError with the file's name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with naming(path):
        figure.savefig(path, dpi=dpi, **more)
