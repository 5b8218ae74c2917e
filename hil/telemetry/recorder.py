"""MCAP recordings: self-describing, for any viewer, readable to the last half second when cut short.

Attachment `run.json` (first in the file) and metadata `hil` hold rig, hash, version and platform. Topics: `tick` (every
tick, at the time it was due: tick_schema.py), `cycle` (what went in and out, to the byte, for replay: cycle_codec.py)
and `status` (10 Hz). More are `commands` (every request, refused ones included), `events` (what happened, one message
each), and `cells` where cells are injected. recording.py reads them.
"""

import contextlib
import errno
import json
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import mcap.writer
import numpy as np
import zstandard
from google.protobuf.message import Message
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

from drivers.base.text_file import words_of
from drivers.frame import Frame
from hil.cycle.record import RECORD
from hil.cycle.tick import CommandKind, CycleResult, Tick
from hil.events.event import Event
from hil.rig.provenance import describe_run
from hil.rig.schema import RigConfig
from hil.telemetry import cycle_codec, events_pb2
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.event_codec import encode
from hil.telemetry.recording import RUN_ATTACHMENT, TOPICS
from hil.telemetry.tick_codec import TickEncoder
from hil.telemetry.tick_schema import TICK, TickSchema

MESSAGES: dict[str, type[Message]] = {
    "cycle": pb.Cycle,
    "status": pb.Status,
    "commands": pb.CommandEntry,
    "events": events_pb2.Event,
    "cells": pb.Cell,
}
CHUNK_SIZE = 1024 * 1024  # at most; a chunk is written twice a second
BATCH = 500  # ticks of a Cycle message, of twice as many at most: larger ones compress no better, rests worse
FLUSH_NS = 500_000_000  # what a killed process or a power cut can cost
# Levels of zstd: a fifth smaller for 0.08 s of a core each second of four axes; the library's own for who is behind.
DENSE, HASTY = 16, 3
MODE = 0o640
_SUMMARY_KEYS = ("rig_hash", "version", "python", "numpy", "platform", "realtime")


class _Compression:
    """In place of the module `zstandard` in mcap.writer, which has no setting for the level."""

    level = DENSE

    def compress(self, data: bytes) -> bytes:
        return zstandard.compress(data, self.level)


_compression = _Compression()
mcap.writer.zstandard = _compression  # type: ignore[assignment,attr-defined]


def topic_schema(topic: str, schema: TickSchema) -> tuple[str, bytes, dict[str, str]]:
    """Of a topic: its message's full name, the FileDescriptorSet that decodes it, and what more its channel says."""
    if topic == "tick":
        return TICK, schema.files.SerializeToString(), schema.metadata
    kind = MESSAGES[topic]
    return kind.DESCRIPTOR.full_name, build_file_descriptor_set(kind).SerializeToString(), {}


def described_topic(writer: Writer, topic: str, schema: TickSchema) -> tuple[int, dict[str, str]]:
    """Register a topic's schema; its number, and what more its channel says."""
    name, described, more = topic_schema(topic, schema)
    return writer.register_schema(name, "protobuf", described), more


class Recorder:
    """Writes one recording, a new file. No method raises for want of space or a broken disk: `errors` counts, `ok`
    turns False, `problem` says why. encoder: of the rig's ticks. hurried: to be set while more waits to be written than
    is given at once; what is written then is larger, and takes a quarter of the time.
    """

    def __init__(self, path: Path, metadata: dict[str, Any]) -> None:
        self.path = path
        self.errors = 0
        self.ok = False
        self.problem = ""
        self.hurried = False
        self.encoder = TickEncoder(TickSchema(metadata["rig"]))
        self._offset_ns = int(metadata.get("wall_offset_ns", 0))
        self._channels: dict[str, int] = {}
        self._held: list[np.ndarray] = []  # ticks that are not in a Cycle message yet
        self._first = self._lost = 0  # of those held: ring index of the first, ticks missing before it
        self.size = 0  # bytes that are on the disk, all whole chunks
        self._next = 0  # ring index after the last tick taken
        self.durable = 0  # ring index after the last tick that is there
        self._flush_due_ns: int | None = None
        self._file: IO[bytes] | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
            self._fd = os.open(path, flags, MODE)
            self._file = os.fdopen(self._fd, "wb", closefd=False)
            self._writer = Writer(self._file, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD)
            self._begin(metadata)
            self.ok = True
        except OSError as error:
            self._fail(error)

    def _begin(self, metadata: dict[str, Any]) -> None:
        self._writer.start(profile="hil", library=f"hil {metadata.get('version', '')}")
        self._description = json.dumps(metadata).encode()
        self._describe()
        self._writer.add_metadata("hil", {key: str(metadata.get(key, "")) for key in _SUMMARY_KEYS})
        for topic in TOPICS:
            self._register(topic)
        self._to_disk()

    def _register(self, topic: str) -> None:
        schema, more = described_topic(self._writer, topic, self.encoder.schema)
        self._channels[topic] = self._writer.register_channel(topic, "protobuf", schema, more)

    def _describe(self) -> None:
        now = time.time_ns()
        self._writer.add_attachment(now, now, RUN_ATTACHMENT, "application/json", self._description)

    def ticks(self, records: cycle_codec.Records, messages: Sequence[bytes], *, first: int, lost: int) -> None:
        """Append ticks, at least one. messages: their Tick messages. first: ring index. lost: missing before them."""
        if not self.ok:
            return
        if self._held and first != self._next:
            self._end_batch()
        if not self._held:
            self._first, self._lost = first, lost
        try:
            for due_ns, data in zip(records["scheduled_ns"].tolist(), messages, strict=True):
                at = due_ns + self._offset_ns
                self._writer.add_message(self._channels["tick"], at, data, at)
        except OSError as error:
            self._fail(error)
            return
        self._held.append(records.copy())
        self._next = first + len(records)
        self.flush(int(records["now_ns"][-1]), at_once=sum(map(len, self._held)) >= BATCH)

    def write(self, topic: str, time_ns: int, data: bytes) -> None:
        """Append a serialised message. time_ns: monotonic."""
        if not self.ok:
            return
        at = time_ns + self._offset_ns
        try:
            if topic not in self._channels:  # of a rig that injects cells alone
                self._register(topic)
            self._writer.add_message(self._channels[topic], at, data, at)
        except OSError as error:
            self._fail(error)
        self.flush(time_ns)

    def flush(self, now_ns: int, *, at_once: bool = False) -> None:
        """Put what is held on the disk where it is due. now_ns: monotonic."""
        if self._flush_due_ns is None:
            self._flush_due_ns = now_ns + FLUSH_NS
        if not self.ok or (now_ns < self._flush_due_ns and not at_once):
            return
        self._flush_due_ns = now_ns + FLUSH_NS
        self._end_batch()
        try:
            self._to_disk()
        except OSError as error:
            self._fail(error)

    def _end_batch(self) -> None:
        if not self._held or not self.ok:
            return
        records = np.concatenate(self._held)
        self._held.clear()
        axes = len(self.encoder.schema.axes)
        at = int(records["now_ns"][-1]) + self._offset_ns
        try:
            for start in range(0, len(records), 2 * BATCH):
                part = records[start : start + 2 * BATCH]
                lost, self._lost = self._lost, 0
                message = cycle_codec.encode(part, axes, first=self._first + start, lost=lost)
                self._writer.add_message(self._channels["cycle"], at, message.SerializeToString(), at)
        except OSError as error:
            self._fail(error)

    def _to_disk(self) -> None:
        """End the chunk."""
        _compression.level = HASTY if self.hurried else DENSE
        self._writer.flush()  # type: ignore[no-untyped-call]
        if self._next and self._description:  # once more behind the first ticks: one hole does not take both
            self._describe()
            self._description = b""
        if self._file is not None:
            self.size = self._file.tell()
            if not self._held:
                self.durable = self._next

    def _fail(self, error: OSError) -> None:
        """Give up this recording: what is whole stays on the disk; a chunk that was cut off goes, and a file without
        ticks."""
        self.errors += 1
        self.ok = False
        self.problem = words_of(error)
        if self._file is None:  # it could not be made
            return
        with contextlib.suppress(OSError):  # what was buffered does not fit either
            self._file.close()
        with contextlib.suppress(OSError):
            os.ftruncate(self._fd, self.size)
            if not self.durable:
                self.path.unlink()
        os.close(self._fd)
        self._file = None

    def close(self) -> None:
        """Write what is held, index and summary; idempotent."""
        self._end_batch()
        if self._file is None or not self.ok:
            return
        try:
            self._to_disk()
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.flush()
            self.size = self._file.tell()
            self._file.close()
        except OSError as error:
            self._fail(error)
            return
        os.close(self._fd)
        self._file = None
        self.ok = False


class LockstepRecorder:
    """Records a lockstep run as the sidecar records a live one: give `observe` to hil.virtual.lockstep as its observer.

    rig_file: where the rig was read from (files it names are beside it). baseline: that the run is held
    against. Raises OSError, which names the file, when it cannot write.
    """

    def __init__(self, path: Path, rig: RigConfig, rig_file: Path, baseline: dict[str, Any] | None = None) -> None:
        described = describe_run(rig, rig_file.parent, realtime="lockstep", baseline=baseline)
        metadata = {**described, "wall_offset_ns": 0}
        self._recorder = Recorder(path, metadata)
        self._records = np.zeros(BATCH, RECORD)
        self._held = 0
        self._first = self._told = 0
        self._check()

    def observe(self, tick: Tick, _frames: Sequence[Frame], result: CycleResult) -> None:
        """Take one tick in."""
        if tick.task:
            self._note_loaded(tick, CommandKind.LOAD_TASK, tick.task.document)
        if tick.law:
            self._note_loaded(tick, CommandKind.SET_LAW, tick.law.document)
        self._records[self._held] = result.record
        self._held += 1
        if self._held == BATCH:
            self._flush()

    def tell(self, events: Sequence[Event]) -> None:
        """Take events in, as hil.virtual.sim tells them."""
        for event in events:
            self._recorder.write("events", event.time_ns, encode(event, self._told, 0).SerializeToString())
            self._told += 1

    def _note_loaded(self, tick: Tick, kind: CommandKind, document: str) -> None:
        posted = next(command.sequence for command in tick.commands if command.kind == kind)
        entry = pb.CommandEntry(kind=kind, when_ns=tick.now_ns, posted=posted, task=document.encode())
        self._recorder.write("commands", tick.now_ns, entry.SerializeToString())

    def _flush(self) -> None:
        write_batch(self._recorder, self._records[: self._held], first=self._first, lost=0)
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
            raise OSError(errno.EIO, f"cannot be written: {self._recorder.problem}", str(self._recorder.path))


def write_batch(recorder: Recorder, records: cycle_codec.Records, *, first: int, lost: int) -> None:
    """Append ticks (at least one) to a recording."""
    recorder.ticks(records, list(recorder.encoder.encode(records, first)), first=first, lost=lost)
