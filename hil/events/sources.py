"""Where events are told from: a cycle that runs in this process, or the ring of another.

What the cycle says in words (notes.py) does not fit into a record of fixed size. Lockstep and replay ask the cycle for
it after every tick; the live control process leaves it in a file, with the tick in which it said so.
"""

import math
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.cycle.goal import LEAD_OUT
from hil.events.event import Event
from hil.events.notes import Note, Speaker, noted, read_notes
from hil.events.stream import EventStream, stream_of
from hil.events.table import KINDS, Kind
from hil.rig.schema import RigConfig

_NAMES = {Kind.DRIVE: "not ready", Kind.LAW: "failed", Kind.TIP: "left beyond its safe height"}


def event_of(note: Note, period_ns: int) -> Event:
    """The event that words are."""
    text = KINDS[note.kind]
    run_ns = max(note.tick, 0) * period_ns
    cause, _, action = note.text.partition(LEAD_OUT) if note.kind is Kind.TIP else (note.text, "", "")
    return Event(
        note.kind, text.severity, _NAMES[note.kind], note.tick, note.time_ns, run_ns, "", "", math.nan, math.nan, "",
        cause, action or text.action,
    )  # fmt: skip


class CycleEvents:
    """Tells the events of a cycle that runs in this process, tick by tick."""

    def __init__(self, stream: EventStream, period_ns: int) -> None:
        self._stream = stream
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


def events_of(rig: RigConfig, baseline: dict[str, Any] | None = None) -> CycleEvents:
    """Those of a cycle of this rig. baseline: a valid one that its accuracy is held against."""
    document = rig.model_dump(include={"name", "axes", "sensors"})
    return CycleEvents(stream_of(document, rig.period_ns, baseline), rig.period_ns)


class Ring(Protocol):
    """What a reader of a ring knows of the run (hil/live/ring.py)."""

    @property
    def metadata(self) -> dict[str, Any]:
        """The run's description."""

    @property
    def period_ns(self) -> int:
        """Of the run."""


class Batch(Protocol):
    """Ticks that a reader took out of the ring."""

    @property
    def records(self) -> NDArray[np.void]:
        """In order."""

    @property
    def first(self) -> int:
        """Ring index of the first."""


class RingEvents:
    """Tells the events of one ring, batch by batch as its reader gets them. notes: the file of hil/events/notes.py.
    begin: ring index from which ticks that are missing are a loss; None: from the first that is there on.
    """

    def __init__(self, reader: Ring, notes: Path, begin: int | None = 0) -> None:
        self._stream = stream_of(reader.metadata["rig"], reader.period_ns, reader.metadata.get("baseline"))
        self._period_ns = reader.period_ns
        self._path = notes
        self._notes: list[Note] = []
        self._next = begin  # ring index

    @property
    def latched(self) -> Event | None:
        """The event of the fault that is latched now."""
        return self._stream.latched

    def tell(self, batch: Batch) -> list[Event]:
        """What these ticks told, and what was put into words since."""
        # A batch without records may have lost some.
        told = self._stream.tell(batch.records, 0 if self._next is None else max(batch.first - self._next, 0))
        if len(batch.records):
            self._next = batch.first + len(batch.records)
        return [*told, *self._stream.admit(self._fresh())]

    def _fresh(self) -> list[Event]:
        before, self._notes = self._notes, read_notes(self._path)
        return [event_of(note, self._period_ns) for note in self._notes if note not in before]

    def close(self) -> list[Event]:
        """What is still held back."""
        return [*self._stream.admit(self._fresh()), *self._stream.close()]
