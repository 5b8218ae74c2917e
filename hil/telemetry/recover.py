"""`hil recover`: a recording that was cut short or damaged, as a whole file that any reader opens."""

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from google.protobuf.message import DecodeError
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from drivers.base.text_file import UnsuitableFileError, words_of
from hil.cli.exit_status import EXIT_FILE
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.mcap_items import DAMAGED, BombError, McapItems
from hil.telemetry.recorder import CHUNK_SIZE, MODE, described_topic
from hil.telemetry.recording import RUN_ATTACHMENT, Gaps, RecordingError, loss_text, topic_of
from hil.telemetry.tick_schema import TickSchema


class Recovered(NamedTuple):
    """What is in the new file. ticks: that replay can use. seconds: from the first message to the last. loss: what the
    old one has lost, in words; empty where it was whole.
    """

    path: Path
    messages: int
    ticks: int
    seconds: float
    loss: str


class _Copy:
    """Writes the items of one file into another."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        self._cycles: set[int] = set()  # channels
        self.gaps = Gaps()
        self.period_s = 0.0
        self.damaged = False  # what came so far
        self.messages = self.ticks = 0
        self.times: list[int] = []  # of the first and the last

    def add(self, item: object) -> None:
        """Copy one; what stands in a file's summary again is left out. Raises ValueError for what has no place."""
        if isinstance(item, Schema):
            if item.id not in self._schemas:
                self._schemas[item.id] = self._writer.register_schema(item.name, item.encoding, item.data)
        elif isinstance(item, Channel):
            if item.id not in self._channels:
                self._add_channel(item)
        elif isinstance(item, Attachment):
            if item.name == RUN_ATTACHMENT:
                if self.described:
                    return  # recorders write it twice
                self._describe(item.data)
            self._writer.add_attachment(item.create_time, item.log_time, item.name, item.media_type, item.data)
        elif isinstance(item, Metadata):
            self._writer.add_metadata(item.name, item.metadata)
        elif isinstance(item, Message):
            self._add_message(item)

    @property
    def described(self) -> bool:
        """It has been said what rig this is."""
        return self.period_s > 0.0

    def _describe(self, data: bytes) -> None:
        rig = json.loads(data)["rig"]
        self.period_s = 1.0 / float(rig["rate_hz"])
        self._schema = TickSchema(rig)

    def _channel(self, number: int) -> int:
        """The new file's channel; of a recorder's topics, where the old one's list of them is damaged."""
        if number not in self._channels:
            topic = topic_of(number)
            if not topic or not self.described:
                raise ValueError("a message without its topic")
            schema, metadata = described_topic(self._writer, topic, self._schema)
            self._channels[number] = self._writer.register_channel(topic, "protobuf", schema, metadata)
            self._cycles |= {number} if topic == "cycle" else set()
        return self._channels[number]

    def _add_channel(self, channel: Channel) -> None:
        if channel.schema_id not in self._schemas:
            raise ValueError(f"topic {channel.topic!a} without its schema")
        schema = self._schemas[channel.schema_id]
        number = self._writer.register_channel(channel.topic, channel.message_encoding, schema, channel.metadata)
        self._channels[channel.id] = number
        if channel.topic == "cycle":
            self._cycles.add(channel.id)

    def _add_message(self, message: Message) -> None:
        channel = self._channel(message.channel_id)
        if message.channel_id in self._cycles:
            cycle = pb.Cycle.FromString(message.data)
            self.gaps.add(cycle.first, len(cycle.index), cycle.lost, damaged=self.damaged)
            self.ticks += len(cycle.index)
        self._writer.add_message(channel, message.log_time, message.data, message.publish_time, message.sequence)
        self.messages += 1
        self.times = [self.times[0] if self.times else message.log_time, message.log_time]


def _as_it_is(item: Any) -> Any:
    return item


def recover(path: Path, target: Path, changed: Callable[[Any], Any] = _as_it_is) -> Recovered:
    """Copy all that is whole in a recording to `target`, a new file, with index and summary.

    changed: makes of each item the one that is written; an item of which it raises ValueError is left out. Raises
    RecordingError where it is no recording, or `target` is there already or cannot be written.
    """
    try:
        descriptor = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, MODE)
    except OSError as error:
        raise RecordingError(f"{target}: {words_of(error)}") from None
    try:
        with os.fdopen(descriptor, "wb") as file:
            writer = Writer(file, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
            writer.start(profile="hil", library="hil recover")
            copy = _Copy(writer)
            items = McapItems(path)
            for item in items:
                copy.damaged |= items.damaged
                try:
                    copy.add(changed(item))
                except (*DAMAGED, DecodeError, KeyError, TypeError):
                    copy.damaged = True
            if not copy.described:
                raise RecordingError(f"{path}: not a recording of a control process")
            writer.finish()  # type: ignore[no-untyped-call]
    except BaseException as error:
        target.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise RecordingError(f"{error.filename or target}: {words_of(error)}") from None
        if isinstance(error, UnsuitableFileError | BombError):
            raise RecordingError(f"{path}: not a recording of a control process: {error}") from None
        raise
    seconds = (copy.times[1] - copy.times[0]) * 1e-9 if copy.times else 0.0
    loss = loss_text(copy.gaps.found, copy.period_s, damaged=copy.damaged or items.damaged)
    return Recovered(target, copy.messages, copy.ticks, seconds, loss)


def command(
    recording: Annotated[Path, typer.Argument(help="a recording that was cut short", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="the new file [FILE.recovered.mcap]")] = None,
) -> None:
    """Write all that is whole in RECORDING to a new file that any MCAP reader opens. RECORDING stays as it is.

    Exit status 0: nothing is missing; 1: something is, and the new file has the rest; 74: there is no new file.
    """
    try:
        found = recover(recording, out or recording.with_suffix(".recovered.mcap"))
    except RecordingError as error:
        print(f"hil recover: {error}", file=sys.stderr)
        raise typer.Exit(EXIT_FILE) from None
    state = found.loss or "it was whole"
    print(f"{found.path}: {found.messages} messages, {found.ticks} ticks, {found.seconds:.1f} s; {state}")
    if found.loss:
        raise typer.Exit(1)
