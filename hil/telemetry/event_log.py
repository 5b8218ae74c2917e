"""The sidecar's events: numbered, kept for those who join late, published, recorded."""

import math
import os
import time
from collections import deque
from collections.abc import Iterable

from hil.cycle.event import Event
from hil.cycle.event_storm import Tallies
from hil.cycle.event_table import KINDS, Kind, Severity
from hil.live.teller import print_events
from hil.telemetry import events_pb2 as pb
from hil.telemetry.event_codec import encode
from hil.telemetry.publisher import Publisher
from hil.telemetry.recorder import Recorder

KEPT = 2000  # events
TOPIC = "events"


class EventLog:
    """All events of one sidecar's life, over any number of control processes."""

    def __init__(self, rig: str, publisher: Publisher) -> None:
        self._rig = rig
        self._publisher = publisher
        self._sidecar = time.time_ns() << 8 & (1 << 63) - 1 | os.getpid() & 0xFF  # two never have the same
        self._kept: deque[pb.Event] = deque(maxlen=KEPT)
        self._told = 0
        self._tallies = Tallies()  # of the sidecar's own
        self.recorder: Recorder | None = None  # of the run that is followed

    def tell(self, events: Iterable[Event]) -> None:
        """Those of a run's ticks; the journal has them from the control process' own child (hil/live/teller.py)."""
        offset_ns = time.time_ns() - time.monotonic_ns()
        fresh = []
        for event in events:
            message = encode(event, self._told, offset_ns)
            self._told += 1
            fresh.append(message)
            if self.recorder:
                self.recorder.write(TOPIC, event.time_ns, message.SerializeToString())
        self._kept.extend(fresh)
        if fresh:
            self._publisher.put(TOPIC, self._message(fresh))

    def own(self, now_ns: int, event: Event) -> None:
        """One of the sidecar's own, for the journal, too."""
        self.turn(now_ns)
        self._tell_own(self._tallies.admit([event]))

    def _tell_own(self, events: list[Event]) -> None:
        self.tell(events)
        print_events(events)

    def history(self) -> bytes:
        """For those who ask what happened before they came: all that is kept."""
        return self._message(self._kept)

    def turn(self, now_ns: int) -> None:
        """What a storm of the sidecar's own events has left to tell, once its second is over."""
        self._tell_own(self._tallies.turn(now_ns // 1_000_000_000))

    def _message(self, events: Iterable[pb.Event]) -> bytes:
        dropped = self._told - len(self._kept)
        return pb.Events(rig=self._rig, sidecar=self._sidecar, dropped=dropped, events=events).SerializeToString()


def own_event(kind: Kind, name: str, now_ns: int, cause: str = "", action: str = "") -> Event:
    """An event outside the control loop, with the words of its kind."""
    text = KINDS[kind]
    severity = Severity.WARNING if cause else text.severity
    return Event(
        kind, severity, name, -1, now_ns, 0, "", "", math.nan, math.nan, "", cause or text.cause, action or text.action
    )
