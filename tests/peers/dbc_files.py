"""DBC files: our reader and codec against cantools', message by message, on drawn payloads."""

import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cantools

from drivers.protocols.base import LayoutError
from drivers.protocols.dbc_codec import compile_codec, is_fd, load_dbc
from tests.peers import dbc_bindings
from tests.peers.files import Tried, in_folder, in_source
from tests.peers.table import DIFFERS, PASSED, Row
from tests.support.paths import RIGS, ROOT

PEER = "cantools"
SUFFIXES = (".dbc",)
PAYLOADS = 20  # drawn for each message
_PLAIN = {"decode_choices": False, "scaling": False}


def rows(work: Path, files: Path | None, *, few: bool) -> Iterator[Row]:
    """A row a file. The short run leaves the peer's own files out: they come with a source that takes a while."""
    tried = [Tried(path, str(path.relative_to(ROOT))) for path in sorted(RIGS.glob("*.dbc"))]
    found, missing = ([], []) if few else in_source(PEER, "tests/files/dbc", SUFFIXES)
    theirs, none = in_folder(files, SUFFIXES, PEER)
    yield from missing + none
    for file in tried + found + theirs:
        yield _of_file(file)
    yield from dbc_bindings.rows(theirs or found or tried, 100 if few else 10_000)


def _of_file(file: Tried) -> Row:
    try:
        ours, refused = load_dbc(file.path), ""
    except LayoutError as error:
        ours, refused = None, str(error).replace(f"{file.path}: ", "")
    try:
        theirs: Any = cantools.database.load_file(file.path, database_format="dbc", strict=False, encoding="cp1252")
    except Exception as error:  # of any kind: the reader is not ours
        both = "neither reads it: " if refused else ""
        told = f"{both}they: {type(error).__name__}: {error}"[:200]
        return Row(PEER, file.name, PASSED if refused else DIFFERS, told, file.own)
    if ours is None:
        return Row(PEER, file.name, DIFFERS, f"we: {refused}", file.own)
    found, messages = _differences(ours, theirs)
    return Row(PEER, file.name, DIFFERS if found else PASSED, found or f"{messages} messages", file.own)


def _differences(ours: Any, theirs: Any) -> tuple[str, int]:
    """The first difference, and how many messages were decoded and encoded."""
    names = [message.name for message in ours.messages], [message.name for message in theirs.messages]
    if names[0] != names[1]:
        return f"messages: they {names[1]}, we {names[0]}", 0
    draw, count = random.Random(1), 0
    for message in theirs.messages:
        paged = message.is_multiplexed() or any(signal.multiplexer_ids for signal in message.signals)
        if paged or message.length > (64 if is_fd(message) else 8):
            continue
        try:
            message.refresh(strict=True)
        except cantools.database.Error:  # its signals overlap, or stand outside of it: nobody binds it
            continue
        codec = compile_codec(ours.get_message_by_name(message.name))
        count += 1
        for _ in range(PAYLOADS):
            data = draw.randbytes(message.length)
            mine = dict(zip(codec.names, codec.unpack(data), strict=True))
            decoded = message.decode(data, **_PLAIN)
            if not _equal(mine, decoded):
                return f"{message.name} {data.hex()}: they {decoded}, we {mine}", count
            if not any(value != value for value in mine.values()):  # a NaN has many encodings
                encoded = message.encode(decoded, scaling=False, padding=False, strict=False)
                packed = codec.pack(*mine.values())
                if packed != encoded:
                    return f"{message.name} {mine}: they {encoded.hex()}, we {packed.hex()}", count
    return "", count


def _equal(mine: dict[str, Any], theirs: dict[str, Any]) -> bool:
    return mine.keys() == theirs.keys() and all(
        value == theirs[name] or (value != value and theirs[name] != theirs[name]) for name, value in mine.items()
    )
