"""A client's view of a batch of cells: what is told from now on, and what was told before it joined."""

import time
from typing import Any

import zenoh
from google.protobuf.message import DecodeError
from zenoh.handlers import FifoChannel, RingChannel

from hil.telemetry import telemetry_pb2 as pb

_KEPT = 200  # messages for a reader that is late
_REPLIES = 4
_ANSWER_S = 2.0
_ASK_AGAIN_S = 1.0


class CellFeed:
    """key: <key>/<rig>/cells."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._session, self._key = session, key
        self._live = session.declare_subscriber(key, RingChannel(_KEPT))
        self._history: Any = None
        self._asked_s = float("-inf")
        self._answered = False

    def take(self) -> list[pb.Cell]:
        """What has come since the last call, the answer about earlier cells first. Never waits."""
        found = self._take_history()
        while sample := self._live.try_recv():
            found += _cells(sample, pb.Cell)
        return found

    def _take_history(self) -> list[pb.Cell]:
        found: list[pb.Cell] = []
        if self._history is None:
            if not self._answered and time.monotonic() - self._asked_s >= _ASK_AGAIN_S:
                self._asked_s = time.monotonic()
                self._history = self._session.get(self._key, FifoChannel(_REPLIES), timeout=_ANSWER_S)
            return found
        try:
            while reply := self._history.try_recv():
                if reply.ok:
                    found += _cells(reply.ok, pb.Cells)
                    self._answered = True
        except zenoh.ZError:  # the channel is closed: no more replies will come
            self._history = None
        return found


def _cells(sample: zenoh.Sample, kind: type[pb.Cell] | type[pb.Cells]) -> list[pb.Cell]:
    try:
        message = kind.FromString(sample.payload.to_bytes())
    except DecodeError:  # of another version, or of anybody else who can publish there
        return []
    return [message] if isinstance(message, pb.Cell) else list(message.cells)
