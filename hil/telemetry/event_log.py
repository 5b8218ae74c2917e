"""The sidecar's events: numbered, kept for those who join late, published, recorded."""

import math
import os
import time
from collections.abc import Iterable
from pathlib import Path

from hil.events.event import Event
from hil.events.sources import RingEvents
from hil.events.storm import Tallies
from hil.events.table import KINDS, REFUSED_ACTION, Kind, Severity
from hil.live.ring import Batch, RingReader
from hil.live.teller import print_events
from hil.telemetry import events_pb2 as pb
from hil.telemetry.event_codec import encode
from hil.telemetry.kept_events import KeptEvents
from hil.telemetry.publisher import Publisher
from hil.telemetry.run_recorder import RunRecorder
from hil.telemetry.telemetry_pb2 import CommandEntry

_EARLIER = 512  # ticks at once
KEPT = 2000  # events, and as many of those that a busy machine has in every second
TOPIC = "events"


class EventLog:
    """All events of one sidecar's life, over any number of control processes."""

    def __init__(self, rig: str, publisher: Publisher, notes: Path = Path("/nonexistent")) -> None:
        self._rig, self._notes = rig, notes
        self._publisher = publisher
        self._sidecar = time.time_ns() << 8 & (1 << 63) - 1 | os.getpid() & 0xFF  # two never have the same
        self._kept = KeptEvents(KEPT)
        self._tallies = Tallies()  # of the sidecar's own
        self.recorder: RunRecorder | None = None  # of the run that is followed
        self._errors = 0  # of the recorder, that were told
        self._run: RingEvents | None = None
        self.latched: pb.Event | None = None  # of the fault that is latched now, whatever storm has followed it

    def follow(self, reader: RingReader, published: int, recorder: RunRecorder | None) -> None:
        """A control process. published: ticks an earlier sidecar came to; what those told is kept, for who joins late,
        and neither published nor recorded again.
        """
        self._run = RingEvents(reader, self._notes, begin=None if published else 0)
        self._errors, self.recorder, self.latched = 0, None, None
        reader.next = min(max(reader.written - reader.slots + _EARLIER, 0), published)  # none that is being overwritten
        while reader.next < published:
            batch = reader.read(min(_EARLIER, published - reader.next))
            self._keep(self._run.tell(batch))
        self.recorder = recorder
        now_ns = time.monotonic_ns()
        self.own(now_ns, own_event(Kind.SIDECAR, f"follows control process {reader.pid}", now_ns))

    def batch(self, batch: Batch) -> None:
        """Ticks of the run that is followed."""
        if self._run:
            self.tell(self._run.tell(batch))

    def conclude(self, reader: RingReader, now_ns: int) -> None:
        """The control process that was followed is gone."""
        self.leave()
        fate = "ended" if reader.ended else "was killed"
        why = () if reader.ended else ("it did not end by itself", "hil blackbox RIG, once this sidecar is gone")
        self.own(now_ns, own_event(Kind.SIDECAR, f"control process {reader.pid} {fate}", now_ns, *why))

    def leave(self) -> None:
        """Tell what is still held back of the run."""
        run, self._run = self._run, None
        if run:
            self.tell(run.close())

    def request(self, name: str, entry: CommandEntry) -> None:
        """A request; told where it was refused."""
        if not entry.accepted:
            cause = f"{entry.reason}; asked by {entry.who}; the state is {entry.state or 'not known'}"
            self.tell([own_event(Kind.REQUEST, f"{name} refused", entry.when_ns, cause, REFUSED_ACTION)])

    def tell(self, events: Iterable[Event]) -> None:
        """Those of a run's ticks; the journal has them from the control process' own child (hil/live/teller.py)."""
        fresh = self._keep(events)
        if self.recorder:
            for message in fresh:
                self.recorder.write(TOPIC, message.time_ns, message.SerializeToString())
        if fresh:
            self._publisher.put(TOPIC, self._message(fresh))

    def _keep(self, events: Iterable[Event]) -> list[pb.Event]:
        offset_ns = time.time_ns() - time.monotonic_ns()
        fresh: list[pb.Event] = []
        for event in events:
            fresh.append(encode(event, self._kept.told + len(fresh), offset_ns))
            if event.kind is Kind.FAULT_LATCHED:
                self.latched = fresh[-1]
            elif event.kind is Kind.FAULT_CLEARED and self.latched and event.name == self.latched.name:
                self.latched = None
        self._kept.add(fresh)
        return fresh

    def own(self, now_ns: int, event: Event) -> None:
        """One of the sidecar's own, for the journal, too."""
        self.turn(now_ns)
        self._tell_own(self._tallies.admit([event]))

    def _tell_own(self, events: list[Event]) -> None:
        self.tell(events)
        print_events(events)

    def history(self) -> bytes:
        """For those who ask what happened before they came: all that is kept."""
        return self._message(self._kept.since())

    def turn(self, now_ns: int) -> None:
        """What a storm of the sidecar's own events has left to tell, once its second is over; a recorder that fails."""
        self._tell_own(self._tallies.turn(now_ns // 1_000_000_000))
        recorder = self.recorder
        if recorder and recorder.errors > self._errors:
            self._errors = recorder.errors
            cause = recorder.problem or KINDS[Kind.RECORDER].cause
            event = own_event(Kind.RECORDER, f"cannot record in {recorder.folder}", now_ns, cause)
            self._tell_own(self._tallies.admit([event._replace(value=float(recorder.errors), limit=0.0)]))

    def _message(self, events: Iterable[pb.Event]) -> bytes:
        message = pb.Events(rig=self._rig, sidecar=self._sidecar, dropped=self._kept.dropped, events=events)
        return message.SerializeToString()


def own_event(kind: Kind, name: str, now_ns: int, cause: str = "", action: str = "") -> Event:
    """An event outside the control loop, with the words of its kind."""
    text = KINDS[kind]
    severity = Severity.WARNING if cause else text.severity
    return Event(
        kind, severity, name, -1, now_ns, 0, "", "", math.nan, math.nan, "", cause or text.cause, action or text.action
    )
