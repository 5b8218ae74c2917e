"""Trace files: our readers against python-can's, frame by frame."""

import random
from collections.abc import Iterator, Sequence
from pathlib import Path

import can

from drivers.frame import STANDARD_MASK
from hil.runs.candump_log import TraceError
from hil.runs.trace_file import read_trace
from tests.peers.files import Tried, in_folder, in_source
from tests.peers.table import DIFFERS, NOT_RUN, PASSED, Row

PEER = "python-can's readers"
SUFFIXES = (".asc", ".log", ".trc", ".blf", ".csv")
TIME_S = 1e-6  # by which two times may differ
_FRAMES = 300


def rows(work: Path, files: Path | None, *, few: bool) -> Iterator[Row]:
    """A row a file. The short run leaves the peer's own files out."""
    tried = [Tried(_generated(work, suffix), f"generated/{suffix[1:]}") for suffix in SUFFIXES if suffix != ".csv"]
    found, missing = ([], []) if few else in_source("python-can", "test/data", SUFFIXES)
    theirs, none = in_folder(files, SUFFIXES, PEER)
    yield from missing + none
    for file in tried + found + theirs:
        yield _of_file(file, theirs)


def _generated(work: Path, suffix: str) -> Path:
    """A file by the peer's own writer: what both can carry, which is classic data frames for .trc."""
    path, draw, at_s = work / f"drawn{suffix}", random.Random(suffix), 1_700_000_000.0
    with can.Logger(path) as writer:
        for _ in range(_FRAMES):
            at_s += round(draw.random(), 4)
            extended, fd = draw.random() < 0.5, suffix != ".trc" and draw.random() < 0.3
            length = draw.choice((0, 8, 12, 64) if fd else (0, 1, 7, 8))
            identifier = draw.randrange(1 << 29 if extended else 1 << 11)
            message = can.Message(
                at_s, identifier, extended, is_fd=fd, data=draw.randbytes(length), channel=0, is_rx=True
            )
            writer.on_message_received(message)
    return path


def _of_file(file: Tried, others: Sequence[Tried]) -> Row:
    try:
        ours, refused = list(read_trace(file.path)), ""
    except TraceError as error:
        ours, refused = [], str(error).replace(f"{file.path}: ", "")
    theirs, told = _by_them(file.path)
    if theirs is None:
        if refused:
            return Row(PEER, file.name, PASSED, told, file.own)
        twin = _twin(file, ours, others)
        if twin:
            return Row(PEER, file.name, PASSED, f"{len(ours)} frames, those of {twin}", file.own)
        return Row(PEER, file.name, NOT_RUN, f"{len(ours)} frames; no second reader has this format: {told}")
    rule = _rule(file.path, ours, refused, theirs)
    found = f"we: {refused}" if refused else _difference(ours, theirs)
    name = f"{file.name}: {rule}" if rule and found else file.name
    return Row(PEER, name, DIFFERS if found else PASSED, found or f"{len(ours)} frames", file.own)


def _by_them(path: Path) -> tuple[list[can.Message] | None, str]:
    try:
        return list(can.LogReader(path)), ""
    except Exception as error:  # of any kind: the reader is not ours
        return None, f"they: {type(error).__name__}: {error}"[:200]


def _twin(file: Tried, ours: Sequence[can.Message], others: Sequence[Tried]) -> str:
    """Another file beside this one that they read, and that has the same frames: one recording in two formats."""
    facts = [(message.arbitration_id, bytes(message.data)) for message in ours]
    for other in others:
        if other.path.parent == file.path.parent and other.path.suffix != ".blf" and other.path != file.path:
            read = _by_them(other.path)[0]
            same = read and [(message.arbitration_id, bytes(message.data)) for message in read] == facts[-len(read) :]
            if read and same and len(facts) - len(read) in (0, 1):  # they miss the one behind a header
                return f"{other.path.name}, which they read"
    return ""


def _rule(path: Path, ours: list[can.Message], refused: str, theirs: list[can.Message]) -> str:
    """What explains a difference, or nothing."""
    impossible = any(message.arbitration_id > STANDARD_MASK and not message.is_extended_id for message in theirs)
    if impossible and "identifier" in refused:
        return "identifiers that no bus carries"
    if path.suffix == ".asc" and len(ours) == len(theirs) + 1 and not _difference(ours[1:], theirs):
        return "the frame behind the header"
    return ""


def _difference(ours: list[can.Message], theirs: list[can.Message]) -> str:
    if len(ours) != len(theirs):
        return f"they have {len(theirs)} frames, we {len(ours)}"
    for place, (mine, other) in enumerate(zip(ours, theirs, strict=True)):
        facts = [
            (m.arbitration_id, m.is_extended_id, m.is_remote_frame, m.is_error_frame, m.is_fd, m.dlc, bytes(m.data))
            for m in (mine, other)
        ]
        apart = (mine.timestamp - ours[0].timestamp) - (other.timestamp - theirs[0].timestamp)
        if facts[0] != facts[1] or abs(apart) > TIME_S:
            return f"frame {place}: they {other}, we {mine}"
    return ""
