"""A client's view of a sidecar's events: those to come, those before it joined, and every gap asked for again."""

import zenoh
from google.protobuf.message import DecodeError
from zenoh.handlers import RingChannel

from hil.telemetry import events_pb2 as pb
from hil.telemetry.backlog import Backlog

_KEPT = 200  # messages for a reader that is late
_SIDECARS = 16  # of a rig, one after the other; the oldest are forgotten


class _Got:
    """Which sequence numbers of one sidecar have come: all below `next`, and those of `ahead`."""

    def __init__(self) -> None:
        self.next = 0
        self.ahead: set[int] = set()

    def take(self, message: pb.Events) -> list[pb.Event]:
        """Those of its events that had not come."""
        fresh = [event for event in message.events if event.sequence >= self.next and event.sequence not in self.ahead]
        self.ahead.update(event.sequence for event in fresh)
        if message.dropped > self.next:  # nobody has those any more
            self.next = message.dropped
            self.ahead = {number for number in self.ahead if number >= self.next}
        while self.next in self.ahead:
            self.ahead.remove(self.next)
            self.next += 1
        return fresh


class EventFeed:
    """key: <key>/<rig>/events."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._live = session.declare_subscriber(key, RingChannel(_KEPT))
        self._earlier = Backlog(session, key)
        self._got: dict[int, _Got] = {}

    @property
    def answered(self) -> bool:
        """What was told before has come."""
        return self._earlier.answered

    def take(self) -> list[pb.Event]:
        """What has come since the last call, in the order in which it was told. Never waits."""
        found: list[pb.Event] = []
        while sample := self._live.try_recv():
            found += self._fresh(sample)
        for sample in self._earlier.take(wanted=self._gap):
            found += self._fresh(sample)
        return sorted(found, key=lambda event: (event.wall_ns, event.sequence))

    @property
    def _gap(self) -> bool:
        return not self.answered or any(got.ahead for got in self._got.values())

    def _fresh(self, sample: zenoh.Sample) -> list[pb.Event]:
        try:
            message = pb.Events.FromString(sample.payload.to_bytes())
        except DecodeError:  # of another version, or of anybody else who can publish there
            return []
        got = self._got.setdefault(message.sidecar, _Got())
        while len(self._got) > _SIDECARS:
            del self._got[next(iter(self._got))]
        return got.take(message)
