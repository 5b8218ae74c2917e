"""A client of a sidecar: the newest status, every tick. Commands go another way: hil/telemetry/command_client.py."""

import contextlib
import json
import socket
import time
from typing import Any, TypeVar

import zenoh
from google.protobuf.message import DecodeError, Message
from numpy.typing import NDArray
from zenoh.handlers import RingChannel

from drivers.base.toml_file import short
from hil.live.mapped_file import Closing
from hil.live.runtime_paths import known_sidecars
from hil.rig.schema import MAX_AXES
from hil.telemetry import events_pb2 as pb_events
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry import tick_codec
from hil.telemetry.cell_feed import CellFeed
from hil.telemetry.credentials import Credentials
from hil.telemetry.event_feed import EventFeed
from hil.telemetry.session import client_config
from hil.telemetry.tick_schema import TickSchema

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
_MOTION_PER_AXIS = ("position", "velocity", "target", "setpoint", "setpoint_velocity")
_PER_AXIS = ("units", "position", "setpoint", "max_error", "force", "drive_status", "answer_age")
_LONGEST = 4096  # characters of a text in a status: a path
_POLL_S = 0.01
M = TypeVar("M", bound=Message)
_KEPT = 4096  # ticks for a reader that is late
_ANSWER_S = 2.0
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


def decoded(payload: bytes) -> pb.Status | None:
    """A status as it came over Zenoh, fit to be shown; None for what no sidecar of this version publishes."""
    try:
        status = pb.Status.FromString(payload)
    except DecodeError:  # of another version, or of anybody else who can publish there
        return None
    axes = len(status.axes)
    fits = axes <= MAX_AXES and all(len(getattr(status, name)) in (0, axes) for name in _PER_AXIS)
    return printable(status) if fits else None


def decoded_motion(payload: bytes) -> pb.Motion | None:
    """The same of what the axes do."""
    try:
        motion = pb.Motion.FromString(payload)
    except DecodeError:
        return None
    axes = len(motion.position)
    fits = axes <= MAX_AXES and all(len(getattr(motion, name)) == axes for name in _MOTION_PER_AXIS)
    return printable(motion) if fits else None


def printable(status: M) -> M:
    """The message without characters that would command a terminal (ESC and its like), its texts not endless."""
    for field, value in status.ListFields():
        if field.type == field.TYPE_STRING:
            if isinstance(value, str):
                setattr(status, field.name, _line(value))
            else:
                value[:] = [_line(text) for text in value]
        elif isinstance(value, Message):
            printable(value)
    return status


def _line(text: str) -> str:
    return short(text, _LONGEST).replace("\n", "?")


class RigClient(Closing):
    """Connects (and reconnects) to one sidecar. key: [telemetry] key. rig: its name, or * for whichever is there.

    Raises NoSidecarError for names that none can have.
    """

    def __init__(self, endpoint: str, key: str = "hil", rig: str = "*", credentials: Credentials | None = None) -> None:
        self.endpoint = endpoint
        self._key = f"{key}/{rig}"
        try:
            zenoh.KeyExpr(self._key)
        except zenoh.ZError:
            raise NoSidecarError(f"rig {rig!a}, key {key!a}: no sidecar publishes under such names") from None
        self._credentials = credentials
        self._session: zenoh.Session | None = None
        self._statuses: Any = None
        self._motions: Any = None
        self._schema: TickSchema | None = None
        self._period_ns = 0
        self._ticks: Any = None
        self._events: EventFeed | None = None
        self._cells: CellFeed | None = None

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
        return decoded(sample.payload.to_bytes()) if sample else None

    def motion(self) -> pb.Motion | None:
        """The newest word on what the axes do, of 50 a second, that was not returned before; from the first call on."""
        if not self._connect() or self._session is None:
            return None
        if self._motions is None:
            self._motions = self._session.declare_subscriber(f"{self._key}/motion", RingChannel(1))
        sample = self._motions.try_recv()
        return decoded_motion(sample.payload.to_bytes()) if sample else None

    def wait_motion(self, timeout_s: float) -> pb.Motion:
        """The next of these. Raises NoSidecarError."""
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            if motion := self.motion():
                return motion
            time.sleep(_POLL_S / 4)
        raise NoSidecarError(_NOBODY.format(self.endpoint))

    def events(self) -> list[pb_events.Event]:
        """Events that were not returned before, those from before the first call with them; never waits."""
        if not self._connect() or self._session is None:
            return []
        if self._events is None:
            self._events = EventFeed(self._session, f"{self._key}/events")
        return [printable(event) for event in self._events.take()]

    def cells(self) -> list[pb.Cell]:
        """News of cells that are injected, those from before the first call with them; never waits."""
        if not self._connect() or self._session is None:
            return []
        if self._cells is None:
            self._cells = CellFeed(self._session, f"{self._key}/cells")
        return [printable(cell) for cell in self._cells.take()]

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

    def wait_ticks(self, timeout_s: float) -> dict[str, NDArray[Any]]:
        """The ticks since the last call as columns (tick_codec.columns), the newest _KEPT of them; since the first one
        where there was none. scheduled_ns and now_ns count from the control process's slot 0. Raises NoSidecarError.
        """
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            if (schema := self._ask_schema()) and (messages := self._new_ticks(schema)):
                due_ns = [message.tick * self._period_ns for message in messages]
                return tick_codec.columns(messages, due_ns, schema)
            time.sleep(_POLL_S)
        raise NoSidecarError(_NOBODY.format(self.endpoint))

    def _ask_schema(self) -> TickSchema | None:
        """What the rig's ticks look like; the first time, who publishes them is asked."""
        if self._schema is None and self._connect() and self._session is not None:
            for reply in self._session.get(f"{self._key}/rig", timeout=_ANSWER_S):
                if reply.ok is not None:
                    rig = json.loads(reply.ok.payload.to_bytes())["rig"]
                    self._schema, self._period_ns = TickSchema(rig), round(1e9 / rig["rate_hz"])
                    self._ticks = self._session.declare_subscriber(f"{self._key}/tick", RingChannel(_KEPT))
        return self._schema

    def _new_ticks(self, schema: TickSchema) -> list[Any]:
        messages = []
        while (sample := self._ticks.try_recv()) is not None:
            with contextlib.suppress(DecodeError):  # as in `status`
                messages.append(schema.message.FromString(sample.payload.to_bytes()))
        return messages

    def close(self) -> None:
        """Leave."""
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]
