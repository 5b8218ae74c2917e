"""MCAP recordings: self-describing, compressed in small chunks, readable to the last whole chunk when cut short.

Attachment `run.json` (first in the file) and metadata `hil` hold rig, hash, version and platform. Channels: `telemetry`
and `traffic` (every tick, in batches), `status` (10 Hz), `commands` (every
request, refused ones included), `events` (what happened, one message each).
"""

import json
import struct
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
import zstandard
from google.protobuf.message import Message
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel
from mcap.records import Message as McapMessage
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

from drivers.frame import Frame
from drivers.text_file import UnsuitableFileError
from hil.cycle.event import Event
from hil.cycle.record import RECORD
from hil.cycle.tick import CommandKind, CycleResult, LoadedTask, Tick
from hil.rig.file import document_hash
from hil.rig.provenance import describe_run
from hil.rig.schema import RigConfig
from hil.telemetry import codec, events_pb2
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.event_codec import encode
from hil.telemetry.mcap_items import BombError, mcap_items

CHANNELS: dict[str, type[Message]] = {
    "telemetry": pb.Telemetry,
    "traffic": pb.Traffic,
    "status": pb.Status,
    "commands": pb.CommandEntry,
    "events": events_pb2.Event,
}
CHUNK_SIZE = 64 * 1024  # about a tenth of a second at 1 kHz: what a power cut can cost
_LOCKSTEP_BATCH = 50  # ticks
RUN_ATTACHMENT = "run.json"
_SUMMARY_KEYS = ("rig_hash", "version", "python", "numpy", "platform", "realtime")

# What a file that ends anywhere, or has any bit wrong, can cause: a length may be beyond all bounds.
_DAMAGED = (McapError, ValueError, struct.error, zstandard.ZstdError, OverflowError, MemoryError)


class RecordingError(Exception):
    """The file is no recording of a control process."""


class Recorder:
    """Writes one recording. No method raises for want of space or a broken disk: `errors` counts, `ok` turns False."""

    def __init__(self, path: Path, metadata: dict[str, Any]) -> None:
        self.path = path
        self.errors = 0
        self.ok = False
        self._offset_ns = int(metadata.get("wall_offset_ns", 0))
        self._channels: dict[str, int] = {}
        self._sequence = dict.fromkeys(CHANNELS, 0)
        self._file: IO[bytes] | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("wb")
            self._writer = Writer(self._file, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
            self._begin(metadata)
            self.ok = True
        except OSError:
            self._fail()

    def _begin(self, metadata: dict[str, Any]) -> None:
        assert self._file is not None
        self._writer.start(profile="hil", library=f"hil {metadata.get('version', '')}")
        now = time.time_ns()
        self._writer.add_attachment(now, now, RUN_ATTACHMENT, "application/json", json.dumps(metadata).encode())
        self._writer.add_metadata("hil", {key: str(metadata.get(key, "")) for key in _SUMMARY_KEYS})
        for topic, kind in CHANNELS.items():
            descriptors = build_file_descriptor_set(kind).SerializeToString()
            schema = self._writer.register_schema(kind.DESCRIPTOR.full_name, "protobuf", descriptors)
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", schema)
        self._file.flush()

    def write(self, topic: str, time_ns: int, data: bytes) -> None:
        """Append a serialised message. time_ns: monotonic."""
        if not self.ok or self._file is None:
            return
        at = time_ns + self._offset_ns
        try:
            self._writer.add_message(self._channels[topic], at, data, at, self._sequence[topic])
            self._file.flush()
        except OSError:
            self._fail()
        self._sequence[topic] += 1

    def _fail(self) -> None:
        """Give up this recording; what is on the disk stays readable."""
        self.errors += 1
        self.ok = False
        self._abandon()

    def _abandon(self) -> None:
        if self._file is not None:
            try:
                self._file.close()
            except OSError:
                self.errors += 1  # what was buffered did not fit either
            self._file = None

    def close(self) -> None:
        """Write index and summary."""
        if self._file is not None and self.ok:
            try:
                self._writer.finish()  # type: ignore[no-untyped-call]
            except OSError:
                self.errors += 1
        self.ok = False
        self._abandon()


class LockstepRecorder:
    """Records a lockstep run as the sidecar records a live one: give `observe` to hil.virtual.lockstep as its observer.

    rig_file: where the rig was read from (files it names are beside it). Raises RecordingError when it cannot write.
    """

    def __init__(self, path: Path, rig: RigConfig, rig_file: Path) -> None:
        metadata = {**describe_run(rig, rig_file.parent, realtime="lockstep"), "wall_offset_ns": 0}
        self._recorder = Recorder(path, metadata)
        self._n_axes = len(rig.axes)
        self._records = np.zeros(_LOCKSTEP_BATCH, RECORD)
        self._held = 0
        self._first = self._told = 0
        self._check()

    def observe(self, tick: Tick, _frames: Sequence[Frame], result: CycleResult) -> None:
        """Take one tick in."""
        if tick.task:
            self._note_task(tick, tick.task)
        self._records[self._held] = result.record
        self._held += 1
        if self._held == _LOCKSTEP_BATCH:
            self._flush()

    def tell(self, events: Sequence[Event]) -> None:
        """Take events in, as hil.virtual.sim tells them."""
        for event in events:
            self._recorder.write("events", event.time_ns, encode(event, self._told, 0).SerializeToString())
            self._told += 1

    def _note_task(self, tick: Tick, task: LoadedTask) -> None:
        kind = CommandKind.LOAD_TASK
        posted = next(command.sequence for command in tick.commands if command.kind == kind)
        entry = pb.CommandEntry(kind=kind, when_ns=tick.now_ns, posted=posted, task=task.document.encode())
        self._recorder.write("commands", tick.now_ns, entry.SerializeToString())

    def _flush(self) -> None:
        write_batch(self._recorder, self._records[: self._held], self._n_axes, first=self._first, lost=0)
        self._first += self._held
        self._held = 0

    def close(self) -> None:
        """Write what is left, index and summary."""
        if self._held:
            self._flush()
        self._recorder.close()
        self._check()

    def _check(self) -> None:
        if self._recorder.errors:
            raise RecordingError(f"{self._recorder.path}: cannot be written")


def write_batch(recorder: Recorder, records: codec.Records, n_axes: int, *, first: int, lost: int) -> None:
    """Append ticks (at least one) to a recording, on both channels."""
    at = int(records["now_ns"][-1])
    recorder.write("telemetry", at, codec.telemetry(records, n_axes, first=first, lost=lost).SerializeToString())
    recorder.write("traffic", at, codec.traffic(records, first=first).SerializeToString())


class Recorded(NamedTuple):
    """A message of a recording. time_ns: wall clock."""

    topic: str
    time_ns: int
    data: bytes


class Recording:
    """Reads a recording from front to end, cut short or damaged or not.

    path: the file. metadata: what `run.json` holds. truncated: set once iteration has met the end of a file that was
    cut short, or a chunk whose checksum does not hold. Raises RecordingError when the file is none.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.truncated = False
        self.metadata = self._metadata()

    def _metadata(self) -> dict[str, Any]:
        for item in self._items():
            if isinstance(item, Attachment) and item.name == RUN_ATTACHMENT:
                return self._described(item.data)
            if isinstance(item, McapMessage):
                break
        raise RecordingError(f"{self.path}: not a recording of a control process")

    def _described(self, data: bytes) -> dict[str, Any]:
        try:
            metadata = json.loads(data)
            known = isinstance(metadata["rig"], dict) and {"rig_hash", "version"} <= metadata.keys()
            found = document_hash(metadata["rig"])
        except (ValueError, KeyError, TypeError, RecursionError):  # TypeError: no object
            known = False
        if not known:
            raise RecordingError(f"{self.path}: its description ({RUN_ATTACHMENT}) is damaged")
        if found != metadata["rig_hash"]:  # a cycle of another rig would be blamed for its other torques
            raise RecordingError(
                f"{self.path}: its rig does not have the hash that was recorded with it ({found}, not "
                f"{metadata['rig_hash']}): the recording is damaged, or was edited"
            )
        return dict(metadata)

    def _items(self) -> Iterator[Any]:
        try:
            yield from mcap_items(self.path)
        except OSError as error:
            raise RecordingError(f"{self.path}: {error.strerror}") from None
        except (UnsuitableFileError, BombError) as error:
            raise RecordingError(f"{self.path}: not a recording of a control process: {error}") from None
        except _DAMAGED:
            self.truncated = True

    def __iter__(self) -> Iterator[Recorded]:
        topics: dict[int, str] = {}
        for item in self._items():
            if isinstance(item, Channel):
                topics[item.id] = item.topic
            elif isinstance(item, McapMessage):
                if item.channel_id not in topics:  # where its channel stood is damaged
                    self.truncated = True
                    return
                yield Recorded(topics[item.channel_id], item.log_time, item.data)
