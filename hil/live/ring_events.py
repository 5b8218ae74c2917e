"""The events of a control process, out of its ring and of the file with what it says in words."""

from pathlib import Path

from hil.cycle.event import Event
from hil.cycle.event_notes import event_of
from hil.cycle.events import stream_of
from hil.cycle.note import Note
from hil.live.notes import read_notes
from hil.live.ring import Batch, RingReader


class RingEvents:
    """Tells the events of one ring, batch by batch as its reader gets them. notes: the file of hil/live/notes.py.
    begin: ring index from which ticks that are missing are a loss; None: from the first that is there on.
    """

    def __init__(self, reader: RingReader, notes: Path, begin: int | None = 0) -> None:
        self._stream = stream_of(reader.metadata["rig"], reader.period_ns)
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
