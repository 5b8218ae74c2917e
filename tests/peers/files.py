"""Which files the readers are tried on: those in peers' sources, generated ones, and a folder of anybody's."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tests.peers.sources import FOLDER, UnavailableError, source
from tests.peers.table import NOT_RUN, Row


class Tried(NamedTuple):
    """own: it comes from the peer's own tests."""

    path: Path
    name: str
    own: bool = False


def in_source(peer: str, under: str, suffixes: tuple[str, ...]) -> tuple[list[Tried], list[Row]]:
    """The files below a folder of a peer's source; a row that says why where there is no source."""
    try:
        folder = source(peer)
    except UnavailableError as error:
        return [], [Row(peer, f"files of {under}", NOT_RUN, str(error))]
    return [Tried(path, str(path.relative_to(folder)), True) for path in _below(folder / under, suffixes)], []


def in_folder(folder: Path | None, suffixes: tuple[str, ...], peer: str) -> tuple[list[Tried], list[Row]]:
    """The files of FILES; a row that says so where there are none. Their sha256 go to build/peers/files.sha256."""
    found = list(_below(folder, suffixes)) if folder is not None else []
    if folder is None or not found:
        return [], [Row(peer, f"FILES: {', '.join(suffixes)}", NOT_RUN, "no folder of such files given by --files")]
    FOLDER.mkdir(parents=True, exist_ok=True)
    with (FOLDER / "files.sha256").open("a") as listed:
        listed.writelines(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in found)
    return [Tried(path, f"FILES/{path.relative_to(folder)}") for path in found], []


def _below(folder: Path, suffixes: tuple[str, ...]) -> Iterator[Path]:
    return (path for path in sorted(folder.rglob("*")) if path.suffix.lower() in suffixes and path.is_file())
