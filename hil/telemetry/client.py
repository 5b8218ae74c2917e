"""A client of a sidecar: the newest status. Commands are not given over Zenoh: hil/telemetry/command_client.py."""

import contextlib
import socket
import time
from typing import Any, TypeVar

import zenoh
from google.protobuf.message import DecodeError, Message
from zenoh.handlers import RingChannel

from hil.live.mapped_file import Closing
from hil.live.runtime_paths import known_sidecars
from hil.telemetry import events_pb2 as pb_events
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.credentials import Credentials
from hil.telemetry.event_feed import EventFeed
from hil.telemetry.session import client_config

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
_POLL_S = 0.01
M = TypeVar("M", bound=Message)
_KEPT = 200  # batches for a reader that is late
_NOBODY = "no sidecar answers at {}: is `hil sidecar RIG` (or `hil demo RIG`) running?"


class NoSidecarError(Exception):
    """Nobody answers at the endpoint; the text says what to start."""


def find_endpoint(rig: str | None = None) -> str:
    """The endpoint a running sidecar left word of, of this rig or any; else the default one."""
    known = [sidecar.endpoint for sidecar in known_sidecars(rig)]
    return next(filter(listens, known), DEFAULT_ENDPOINT)


def listens(endpoint: str) -> bool:
    """Somebody accepts connections there (tcp endpoints only; others are taken on trust)."""
    protocol, _, address = endpoint.partition("/")
    if protocol != "tcp":
        return True
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=0.5).close()
    except (OSError, ValueError):
        return False
    return True


def printable(status: M) -> M:
    """The message without characters that would command a terminal (ESC and its like)."""
    for field, value in status.ListFields():
        if field.type == field.TYPE_STRING:
            if isinstance(value, str):
                setattr(status, field.name, _printable(value))
            else:
                value[:] = [_printable(text) for text in value]
    return status


def _printable(text: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in text)


class RigClient(Closing):
    """Connects (and reconnects) to one sidecar. key: [telemetry] key. rig: its name, or * for whichever is there."""

    def __init__(self, endpoint: str, key: str = "hil", rig: str = "*", credentials: Credentials | None = None) -> None:
        self.endpoint = endpoint
        self._key = f"{key}/{rig}"
        self._credentials = credentials
        self._session: zenoh.Session | None = None
        self._statuses: Any = None
        self._batches: Any = None
        self._events: EventFeed | None = None

    def _connect(self) -> bool:
        """Open the session as soon as somebody listens; from then on Zenoh itself reconnects."""
        if self._session is None:
            try:
                self._session = zenoh.open(client_config(self.endpoint, self._credentials))
            except zenoh.ZError:
                return False
            self._statuses = self._session.declare_subscriber(f"{self._key}/status", RingChannel(1))
        return True

    def status(self) -> pb.Status | None:
        """The newest status that was not returned before."""
        sample = self._statuses.try_recv() if self._connect() else None
        try:
            return printable(pb.Status.FromString(sample.payload.to_bytes())) if sample else None
        except DecodeError:  # of another version, or of anybody else who can publish there
            return None

    def events(self) -> list[pb_events.Event]:
        """Events that were not returned before, those from before the first call with them; never waits."""
        if not self._connect() or self._session is None:
            return []
        if self._events is None:
            self._events = EventFeed(self._session, f"{self._key}/events")
        return [printable(event) for event in self._events.take()]

    def wait_events(self, timeout_s: float) -> list[pb_events.Event]:
        """All events the sidecar still keeps. Raises NoSidecarError."""
        found: list[pb_events.Event] = []
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            found += self.events()
            if self._events and self._events.answered:
                return found
            time.sleep(_POLL_S)
        raise NoSidecarError(_NOBODY.format(self.endpoint))

    def wait_status(self, timeout_s: float) -> pb.Status:
        """The next status. Raises NoSidecarError."""
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            if status := self.status():
                return status
            time.sleep(_POLL_S)
        raise NoSidecarError(_NOBODY.format(self.endpoint))

    def wait_telemetry(self, timeout_s: float) -> pb.Telemetry:
        """The next batch of ticks since this was first called, the oldest of at most _KEPT. Raises NoSidecarError."""
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            if self._connect() and self._batches is None and self._session is not None:
                self._batches = self._session.declare_subscriber(f"{self._key}/telemetry", RingChannel(_KEPT))
            sample = self._batches.try_recv() if self._batches is not None else None
            if sample is None:
                time.sleep(_POLL_S)
                continue
            with contextlib.suppress(DecodeError):  # as in `status`
                return pb.Telemetry.FromString(sample.payload.to_bytes())
        raise NoSidecarError(_NOBODY.format(self.endpoint))

    def close(self) -> None:
        """Leave."""
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]
