"""A client's view of a sidecar's events: those to come, those before it joined, and every gap asked for again."""

import time
from typing import Any

import zenoh
from google.protobuf.message import DecodeError
from zenoh.handlers import FifoChannel, RingChannel

from hil.telemetry import events_pb2 as pb

_KEPT = 200  # messages for a reader that is late
_REPLIES = 16
_SIDECARS = 16  # of a rig, one after the other; the oldest are forgotten
_ANSWER_S = 2.0
_ASK_AGAIN_S = 1.0


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
        self._session, self._key = session, key
        self._live = session.declare_subscriber(key, RingChannel(_KEPT))
        self._history: Any = None
        self._asked_s = float("-inf")
        self._got: dict[int, _Got] = {}
        self.answered = False  # what was told before has come

    def take(self) -> list[pb.Event]:
        """What has come since the last call, in the order in which it was told. Never waits."""
        found: list[pb.Event] = []
        while sample := self._live.try_recv():
            found += self._fresh(sample)
        found += self._take_history()
        return sorted(found, key=lambda event: (event.wall_ns, event.sequence))

    @property
    def _gap(self) -> bool:
        return not self.answered or any(got.ahead for got in self._got.values())

    def _take_history(self) -> list[pb.Event]:
        found: list[pb.Event] = []
        if self._history is None:
            if self._gap and time.monotonic() - self._asked_s >= _ASK_AGAIN_S:
                self._asked_s = time.monotonic()
                self._history = self._session.get(self._key, FifoChannel(_REPLIES), timeout=_ANSWER_S)
            return found
        try:
            while reply := self._history.try_recv():
                if reply.ok:
                    found += self._fresh(reply.ok)
                    self.answered = True
        except zenoh.ZError:  # the channel is closed: no more replies will come
            self._history = None
        return found

    def _fresh(self, sample: zenoh.Sample) -> list[pb.Event]:
        try:
            message = pb.Events.FromString(sample.payload.to_bytes())
        except DecodeError:  # of another version, or of anybody else who can publish there
            return []
        got = self._got.setdefault(message.sidecar, _Got())
        while len(self._got) > _SIDECARS:
            del self._got[next(iter(self._got))]
        return got.take(message)
