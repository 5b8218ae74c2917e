"""What the cycle says in words: why a drive was refused, what a user's law did wrong, that the tip was left inside.

It goes from the control process to all others by a file.
"""

import contextlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

from drivers.base.runtime import read_private, write_private
from hil.events.table import Kind

MOST = 16  # at a time
LONGEST = 400  # characters of one


class Note(NamedTuple):
    """Words of the cycle. kind: DRIVE, LAW or TIP. tick, time_ns: when they were there first."""

    kind: Kind
    text: str
    tick: int
    time_ns: int


class Speaker(Protocol):
    """What of the control cycle has something to say."""

    @property
    def problems(self) -> list[str]:
        """Why drives were refused or an axis is not as stated."""

    @property
    def tip(self) -> str:
        """That the tip stays beyond its safe height, or empty."""

    @property
    def failure(self) -> str:
        """Why a user's law no longer counts, or empty."""


def noted(speaker: Speaker, before: Sequence[Note], tick: int, time_ns: int) -> tuple[Note, ...]:
    """What it says now; what it said before keeps its tick."""
    problems, failure, tip = speaker.problems, speaker.failure, speaker.tip
    if not (problems or failure or tip):
        return ()
    said = [(Kind.DRIVE, text) for text in problems]
    said += [(kind, text) for kind, text in ((Kind.LAW, failure), (Kind.TIP, tip)) if text]
    known = {(note.kind, note.text): note for note in before}
    cut = [(kind, " ".join(text.split())[:LONGEST]) for kind, text in said[:MOST]]
    return tuple(known.get(words) or Note(*words, tick, time_ns) for words in dict.fromkeys(cut))


class NoteWriter:
    """The control process' side. told: what was last written."""

    def __init__(self, path: Path) -> None:
        self.told: tuple[Note, ...] = ()
        self._path = path
        path.unlink(missing_ok=True)

    def write(self, speaker: Speaker, tick: int, now_ns: int) -> None:
        """Write what is said, if it is other than before. Not for a tick that applies torque: writing may wait."""
        new = noted(speaker, self.told, tick, now_ns)
        if new == self.told:
            return
        self.told = new
        with contextlib.suppress(OSError):  # the runtime directory is gone: the loop goes on
            write_private(self._path, "".join(f"{json.dumps(note)}\n" for note in new))


def read_notes(path: Path) -> list[Note]:
    """What the control process wrote last; nothing where there is none, or no sense in it."""
    notes = []
    try:
        for line in read_private(path).decode().splitlines()[:MOST]:
            kind, text, tick, time_ns = json.loads(line)
            notes.append(Note(Kind(kind), str(text), int(tick), int(time_ns)))
    except (OSError, ValueError, TypeError):
        return []
    return notes


def read_problems(path: Path) -> list[str]:
    """Of what was written last, why drives were refused or an axis is not as stated."""
    return [note.text for note in read_notes(path) if note.kind is Kind.DRIVE]


def read_tip(path: Path) -> str:
    """Of what was written last, that the tip stays beyond its safe height; empty where it does not."""
    return next((note.text for note in read_notes(path) if note.kind is Kind.TIP), "")
