"""Which files the readers are tried on: those in peers' sources, generated ones, and a folder of anybody's."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tests.peers.sources import FOLDER, UnavailableError, source
from tests.peers.table import NOT_RUN, Row

LISTED = Path(__file__).with_name(
    "files.sha256"
)  # public files that were read once: none of them is in this repository
FOUND = FOLDER / "files.sha256"  # those that this run has read


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
    """The files of FILES; a row that says so where there are none. Their sha256 go to FOUND."""
    found = list(_below(folder, suffixes)) if folder is not None else []
    if folder is None or not found:
        return [], [Row(peer, f"FILES: {', '.join(suffixes)}", NOT_RUN, "no folder of such files given by --files")]
    FOLDER.mkdir(parents=True, exist_ok=True)
    with FOUND.open("a") as listed:
        for path in found:
            listed.write(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(folder)}\n")
    return [Tried(path, f"FILES/{path.relative_to(folder)}") for path in found], []


def _below(folder: Path, suffixes: tuple[str, ...]) -> Iterator[Path]:
    return (path for path in sorted(folder.rglob("*")) if path.suffix.lower() in suffixes and path.is_file())


def read_and_listed() -> str:
    """How many files of FILES were read, and how many of them the committed list has."""
    found = {line.split()[0] for line in FOUND.read_text().splitlines()} if FOUND.exists() else set()
    listed = {line.split()[0] for line in LISTED.read_text().splitlines()}
    return f"files: {len(found)} read, {len(found & listed)} of the {len(listed)} in {LISTED.name}"
