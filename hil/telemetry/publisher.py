"""The sidecar's side of Zenoh: what is published under which key."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack

import zenoh
from zenoh.handlers import RingChannel

from hil.live.mapped_file import Closing
from hil.telemetry.credentials import Credentials
from hil.telemetry.session import server_config

_QUERIES_WAITING = 64
QUERIES_A_ROUND = 8
_ANSWERED = {
    "rig": zenoh.Encoding.APPLICATION_JSON,
    "schema": zenoh.Encoding.APPLICATION_PROTOBUF.with_schema("google.protobuf.FileDescriptorSet"),
    "events": zenoh.Encoding.APPLICATION_PROTOBUF.with_schema("hil.telemetry.Events"),
    "cells": zenoh.Encoding.APPLICATION_PROTOBUF.with_schema("hil.telemetry.Cells"),
}


class ListenError(Exception):
    """Zenoh could not listen where the rig file says; the text names the endpoint."""


class Publisher(Closing):
    """An open Zenoh session with the keys of one rig. Nothing blocks: what the network cannot take is dropped."""

    def __init__(self, key: str, rig: str, listen: list[str], credentials: Credentials | None = None) -> None:
        self.key = f"{key}/{rig}"
        self.listen = listen
        self.failed = self.answered = 0
        with ExitStack() as stack:
            self._session = stack.enter_context(_open(listen, self.key, credentials))
            self._publishers = {
                topic: self._session.declare_publisher(
                    f"{self.key}/{topic}",
                    encoding=zenoh.Encoding.APPLICATION_PROTOBUF.with_schema(f"hil.telemetry.{kind}"),
                    congestion_control=zenoh.CongestionControl.DROP,
                )
                for topic, kind in (
                    ("tick", "Tick"),
                    ("status", "Status"),
                    ("motion", "Motion"),
                    ("events", "Events"),
                    ("cells", "Cell"),
                )
            }
            self.queries = {
                name: self._session.declare_queryable(f"{self.key}/{name}", RingChannel(_QUERIES_WAITING))
                for name in _ANSWERED
            }
            self._alive = self._session.liveliness().declare_token(f"{self.key}/alive")
            self._stack = stack.pop_all()

    def put(self, topic: str, data: bytes) -> bool:
        """Publish a serialised message; False (and counted) where Zenoh refused it."""
        try:
            self._publishers[topic].put(data)
        except zenoh.ZError:
            self.failed += 1
            return False
        return True

    def wanted(self, topic: str) -> bool:
        """Somebody subscribes to it."""
        return bool(self._publishers[topic].matching_status.matching)  # type: ignore[attr-defined]

    def answer_queries(self, answers: Mapping[str, Callable[[], bytes]]) -> None:
        """Reply to everybody who asked for "rig", "schema", "events" or "cells". answers: called for each, as hardly
        anybody asks.
        """
        for name, waiting in self.queries.items():
            for _ in range(QUERIES_A_ROUND):
                query = waiting.try_recv()
                if query is None:
                    break
                with query:
                    self.answered += 1
                    query.reply(f"{self.key}/{name}", answers[name](), encoding=_ANSWERED[name])

    def close(self) -> None:
        """Undeclare everything and leave."""
        self._stack.close()


def _open(listen: list[str], key: str, credentials: Credentials | None) -> zenoh.Session:
    try:
        return zenoh.open(server_config(listen, f"{key}/**", credentials))
    except zenoh.ZError as error:
        raise ListenError(f"cannot listen on {', '.join(listen)}: {error}") from None
