"""A rig's live streams for Lichtblick and Foxglove: `hil page --foxglove` answers /foxglove/RIG.

Topics and messages are those of a recording (hil/telemetry/recorder.py): a layout made for one shows the other. A tick
is encoded only while somebody subscribes to ticks. The protocol is specified in the repository
github.com/foxglove/ws-protocol.
"""

import asyncio
import base64
import json
import struct
import time
from collections.abc import Mapping
from typing import Any, Final

from hil.page.hub import TURN_S, Viewer
from hil.page.ring_feed import RingFeed
from hil.page.sidecar_feed import SidecarFeed
from hil.telemetry.recorder import topic_schema
from hil.telemetry.tick_codec import PER_AXIS, PER_SENSOR, PER_TICK, TickEncoder
from hil.telemetry.tick_schema import TickSchema

SUBPROTOCOLS: Final = ("foxglove.sdk.v1", "foxglove.websocket.v1")  # newest first; what is used here is in both
WAITING: Final = 8192  # messages: some seconds of ticks
TOPICS: Final = ("tick", "status", "events")
_MESSAGE_DATA: Final = 1  # opcode
_HEAD: Final = struct.Struct("<BIQ")  # opcode, subscription, ns since 1970
_WARNING: Final = 1


class LiveStreams:
    """What one viewer is sent. sidecar: of the rig. viewer: takes the messages."""

    def __init__(self, rig: str, sidecar: SidecarFeed, viewer: Viewer) -> None:
        self._rig, self._sidecar, self._viewer = rig, sidecar, viewer
        self._ring = RingFeed(rig, tuple(dict.fromkeys((*PER_TICK, *PER_AXIS, *PER_SENSOR))))
        self._encoder: TickEncoder | None = None
        self._offset_ns = 0
        self._run: int | None = None
        self._first = 1  # number of the first channel of this run
        self._subscribed: dict[int, int] = {}  # subscription by channel
        self._status: object = None
        self._told = 0  # events
        self._dropped = 0

    async def run(self) -> None:
        """25 turns a second, until this task is cancelled."""
        try:
            while True:
                self.turn()
                await asyncio.sleep(TURN_S)
        finally:
            self._ring.close()

    def take(self, text: str) -> None:
        """A message of the viewer. Raises ValueError for one that is none."""
        message = json.loads(text)
        asked = message.get("op") if isinstance(message, dict) else None
        try:
            if asked == "subscribe":
                for row in message["subscriptions"]:
                    self._subscribe(int(row["id"]), int(row["channelId"]))
            elif asked == "unsubscribe":
                gone = {int(number) for number in message["subscriptionIds"]}
                self._subscribed = {key: each for key, each in self._subscribed.items() if each not in gone}
            else:
                self._warn(f"{str(asked)[:40]!a}: this server takes subscribe and unsubscribe alone")
        except (KeyError, TypeError) as error:
            raise ValueError(f"{asked}: {error!r}") from None

    def _subscribe(self, number: int, channel: int) -> None:
        """An unknown channel is one of a run that ended meanwhile."""
        if not 0 <= number < 1 << 32:
            raise ValueError(f"subscription {number}: expected 0 to {(1 << 32) - 1}")
        if 0 <= channel - self._first < len(TOPICS):
            self._subscribed[channel] = number
        else:
            self._warn(f"no channel {channel}")

    def turn(self) -> None:
        """Offer what is new."""
        batch = self._ring.read()
        if self._ring.metadata and self._ring.run_id != self._run:
            self._advertise(self._ring.metadata)
        ticks, status, events = (self._subscribed.get(self._first + place) for place in range(len(TOPICS)))
        if batch is not None and ticks is not None and self._encoder is not None:
            due_ns = batch.records["scheduled_ns"] + self._offset_ns
            for at_ns, data in zip(due_ns.tolist(), self._encoder.encode(batch.records, batch.first), strict=True):
                self._send(ticks, at_ns, data)
        newest = self._sidecar.message
        if newest is not None and newest is not self._status and status is not None:
            self._status = newest
            self._send(status, time.time_ns(), newest.SerializeToString())
        if events is not None and self._sidecar.told > self._told:
            self._told, fresh = self._sidecar.event_messages(self._told)
            for event in fresh:
                self._send(events, event.wall_ns, event.SerializeToString())
        if self._viewer.dropped > self._dropped:
            self._dropped = self._viewer.dropped
            self._warn(f"{self._dropped} messages were left out: this connection is too slow")

    def _advertise(self, metadata: Mapping[str, Any]) -> None:
        """The channels of a run; those of the run before are no more."""
        schema = TickSchema(metadata["rig"])
        self._encoder, self._offset_ns = TickEncoder(schema), int(metadata.get("wall_offset_ns", 0))
        if self._run is None:
            self._tell("serverInfo", name=f"hil: {self._rig}", capabilities=[], sessionId=str(self._ring.run_id))
        else:
            self._tell("unadvertise", channelIds=[self._first + place for place in range(len(TOPICS))])
            self._first += len(TOPICS)
            self._subscribed.clear()
        self._run = self._ring.run_id
        channels = []
        for place, topic in enumerate(TOPICS):
            name, described, _ = topic_schema(topic, schema)
            channels.append(
                {
                    "id": self._first + place,
                    "topic": topic,
                    "encoding": "protobuf",
                    "schemaName": name,
                    "schema": base64.b64encode(described).decode(),
                    "schemaEncoding": "protobuf",
                }
            )
        self._tell("advertise", channels=channels)

    def _tell(self, operation: str, **fields: Any) -> None:
        self._viewer.offer(json.dumps({"op": operation, **fields}))

    def _warn(self, text: str) -> None:
        self._tell("status", level=_WARNING, message=text)

    def _send(self, subscription: int, at_ns: int, data: bytes) -> None:
        self._viewer.offer(_HEAD.pack(_MESSAGE_DATA, subscription, at_ns) + data)
