"""What the cycle says in words: why a drive was refused, what an axis or a user's law did wrong."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from hil.cycle.event_table import Kind

MOST = 16  # at a time
LONGEST = 400  # characters of one


class Note(NamedTuple):
    """Words of the cycle. kind: DRIVE or LAW. tick, time_ns: when they were there first."""

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
    def failure(self) -> str:
        """Why a user's law no longer counts, or empty."""


def noted(speaker: Speaker, before: Sequence[Note], tick: int, time_ns: int) -> tuple[Note, ...]:
    """What it says now; what it said before keeps its tick."""
    problems, failure = speaker.problems, speaker.failure
    if not (problems or failure):
        return ()
    said = [(Kind.DRIVE, text) for text in problems] + ([(Kind.LAW, failure)] if failure else [])
    known = {(note.kind, note.text): note for note in before}
    cut = [(kind, " ".join(text.split())[:LONGEST]) for kind, text in said[:MOST]]
    return tuple(known.get(words) or Note(*words, tick, time_ns) for words in dict.fromkeys(cut))
