"""What the cycle says in words (note.py), as events; and all events of a cycle that runs in this process.

Words do not fit into a record of fixed size. Lockstep and replay ask the cycle for them after every tick; the live
control process leaves them in a file (hil/live/notes.py), with the tick in which it did.
"""

import math
from collections.abc import Sequence

import numpy as np

from hil.cycle.event import Event
from hil.cycle.event_table import KINDS, Kind
from hil.cycle.events import EventStream
from hil.cycle.note import Note, Speaker, noted


def event_of(note: Note, period_ns: int) -> Event:
    """The event that words are."""
    text = KINDS[note.kind]
    name = "not ready" if note.kind is Kind.DRIVE else "failed"
    run_ns = max(note.tick, 0) * period_ns
    return Event(
        note.kind, text.severity, name, note.tick, note.time_ns, run_ns, "", "", math.nan, math.nan, "", note.text,
        text.action,
    )  # fmt: skip


class CycleEvents:
    """Tells the events of a cycle that runs in this process, tick by tick."""

    def __init__(self, axes: Sequence[tuple[str, str]], period_ns: int) -> None:
        self._stream = EventStream(axes, period_ns)
        self._period_ns = period_ns
        self._notes: tuple[Note, ...] = ()

    @property
    def latched(self) -> Event | None:
        """The event of the fault that is latched now; up to date after `close`."""
        return self._stream.latched

    def observe(self, speaker: Speaker, record: np.void) -> list[Event]:
        """Take one tick in; what it and those before it told comes with a later one, or with `close`."""
        before, told = self._notes, self._stream.observe(record)
        self._notes = noted(speaker, before, int(record["index"]), int(record["now_ns"]))
        if fresh := [note for note in self._notes if note not in before]:
            told += [*self._stream.release(), *self._stream.admit(event_of(note, self._period_ns) for note in fresh)]
        return told

    def close(self) -> list[Event]:
        """What is still held back."""
        return self._stream.close()
