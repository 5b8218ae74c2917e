"""`hil recover`: a recording that was cut short or damaged, as a whole file that any reader opens."""

import os
import sys
from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from google.protobuf.message import DecodeError
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from drivers.text_file import UnsuitableFileError
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.mcap_items import BombError, mcap_items
from hil.telemetry.recorder import CHUNK_SIZE, MODE
from hil.telemetry.recording import DAMAGED, RUN_ATTACHMENT, RecordingError


class Recovered(NamedTuple):
    """What is in the new file. ticks: that replay can use. seconds: from the first message to the last. whole: the file
    had its end; else the bytes behind the last whole chunk are lost.
    """

    path: Path
    messages: int
    ticks: int
    seconds: float
    whole: bool


class _Copy:
    """Writes the items of one file into another."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        self._cycles: set[int] = set()  # channels
        self.described = False
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
            self.described |= item.name == RUN_ATTACHMENT
            self._writer.add_attachment(item.create_time, item.log_time, item.name, item.media_type, item.data)
        elif isinstance(item, Metadata):
            self._writer.add_metadata(item.name, item.metadata)
        elif isinstance(item, Message):
            self._add_message(item)

    def _add_channel(self, channel: Channel) -> None:
        if channel.schema_id not in self._schemas:
            raise ValueError(f"topic {channel.topic!a} without its schema")
        schema = self._schemas[channel.schema_id]
        number = self._writer.register_channel(channel.topic, channel.message_encoding, schema, channel.metadata)
        self._channels[channel.id] = number
        if channel.topic == "cycle":
            self._cycles.add(channel.id)

    def _add_message(self, message: Message) -> None:
        if message.channel_id not in self._channels:
            raise ValueError("a message without its topic")
        channel = self._channels[message.channel_id]
        self._writer.add_message(channel, message.log_time, message.data, message.publish_time, message.sequence)
        self.messages += 1
        self.times = [self.times[0] if self.times else message.log_time, message.log_time]
        if message.channel_id in self._cycles:
            self.ticks += len(pb.Cycle.FromString(message.data).index)


def recover(path: Path, target: Path) -> Recovered:
    """Copy all that is whole in a recording to `target`, a new file, with index and summary.

    Raises RecordingError where it is no recording, or `target` is there already or cannot be written.
    """
    whole = True
    try:
        descriptor = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, MODE)
    except OSError as error:
        raise RecordingError(f"{target}: {error.strerror}") from None
    try:
        with os.fdopen(descriptor, "wb") as file:
            writer = Writer(file, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
            writer.start(profile="hil", library="hil recover")
            copy = _Copy(writer)
            try:
                for item in mcap_items(path):
                    copy.add(item)
            except (*DAMAGED, DecodeError):
                whole = False
            if not copy.described:
                raise RecordingError(f"{path}: not a recording of a control process")
            writer.finish()  # type: ignore[no-untyped-call]
    except BaseException as error:
        target.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise RecordingError(f"{error.filename or target}: {error.strerror}") from None
        if isinstance(error, UnsuitableFileError | BombError):
            raise RecordingError(f"{path}: not a recording of a control process: {error}") from None
        raise
    seconds = (copy.times[1] - copy.times[0]) * 1e-9 if copy.times else 0.0
    return Recovered(target, copy.messages, copy.ticks, seconds, whole)


def command(
    recording: Annotated[Path, typer.Argument(help="a recording that was cut short", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="the new file [FILE.recovered.mcap]")] = None,
) -> None:
    """Write all that is whole in RECORDING to a new file that any MCAP reader opens. RECORDING stays as it is."""
    try:
        found = recover(recording, out or recording.with_suffix(".recovered.mcap"))
    except RecordingError as error:
        print(f"hil recover: {error}", file=sys.stderr)
        raise typer.Exit(1) from None
    cut = "it was cut short or is damaged, and what is behind the last whole chunk is lost"
    state = "it was whole" if found.whole else cut
    print(f"{found.path}: {found.messages} messages, {found.ticks} ticks, {found.seconds:.1f} s; {state}")
