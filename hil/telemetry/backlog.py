"""What a sidecar told before a client joined, asked for until it has come."""

import time
from typing import Any

import zenoh
from zenoh.handlers import FifoChannel

_REPLIES = 16
_ANSWER_S = 2.0
_ASK_AGAIN_S = 1.0


class Backlog:
    """key: of the queryable that answers with it. answered: an answer has come."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._session, self._key = session, key
        self._replies: Any = None
        self._asked_s = float("-inf")
        self.answered = False

    def take(self, *, wanted: bool) -> list[zenoh.Sample]:
        """The answers that have come. wanted: ask where no question is open, once a second at most. Never waits."""
        found: list[zenoh.Sample] = []
        if self._replies is None:
            if wanted and time.monotonic() - self._asked_s >= _ASK_AGAIN_S:
                self._asked_s = time.monotonic()
                self._replies = self._session.get(self._key, FifoChannel(_REPLIES), timeout=_ANSWER_S)
            return found
        try:
            while reply := self._replies.try_recv():
                if reply.ok:
                    found.append(reply.ok)
                    self.answered = True
        except zenoh.ZError:  # the channel is closed: no more replies will come
            self._replies = None
        return found
