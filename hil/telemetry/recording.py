"""Reads recordings (recorder.py), of today's layout and the earlier one, cut short or damaged or not."""

import itertools
import json
import os
import re
import stat
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

import zstandard
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Chunk
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, breakup_chunk

from hil.rig.file import document_hash

RUN_ATTACHMENT = "run.json"
LARGEST_RECORD = 32 * 2**20  # bytes; the largest is run.json, with a task of many samples
LARGEST_CHUNK = 16 * 2**20  # bytes, unpacked; half a second of a flooded bus takes 2 MB
_PART = re.compile(r"\.part-\d+$")
# What a file that ends anywhere, or has any bit wrong, can cause: a length may be beyond all bounds.
_DAMAGED = (McapError, ValueError, struct.error, zstandard.ZstdError, OverflowError, MemoryError)


class RecordingError(Exception):
    """The file is no recording of a control process, or none can be written."""


class Recorded(NamedTuple):
    """A message of a recording. time_ns: wall clock."""

    topic: str
    time_ns: int
    data: bytes


def part_path(path: Path, number: int) -> Path:
    """Where part `number` (2, 3, ...) of the recording is that `path` is a part of."""
    return path.with_name(f"{_PART.sub('', path.name.removesuffix('.mcap'))}.part-{number}.mcap")


class Recording:
    """Reads a recording from front to end, cut short or damaged or not, and on through the parts that follow it.

    path: the file. metadata: what its `run.json` holds. truncated: set once iteration has met the end of a file that
    was cut short, or a chunk whose checksum does not hold. parts: files met by iteration. Raises RecordingError when
    the file is none.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.truncated = False
        self.parts: list[Path] = []
        self.metadata = self._metadata(path)

    def _metadata(self, path: Path) -> dict[str, Any]:
        for item in self._items(path):
            if isinstance(item, Attachment) and item.name == RUN_ATTACHMENT:
                return self._described(path, item.data)
            if isinstance(item, McapMessage):
                break
        raise RecordingError(f"{path}: not a recording of a control process")

    @staticmethod
    def _described(path: Path, data: bytes) -> dict[str, Any]:
        try:
            metadata = json.loads(data)
            known = isinstance(metadata["rig"], dict) and {"rig_hash", "version"} <= metadata.keys()
        except (ValueError, KeyError, TypeError, RecursionError):  # TypeError: it is no object
            known = False
        if not known:
            raise RecordingError(f"{path}: its description ({RUN_ATTACHMENT}) is damaged")
        found = document_hash(metadata["rig"])
        if found != metadata["rig_hash"]:  # a cycle of another rig would be blamed for its other torques
            raise RecordingError(
                f"{path}: its rig does not have the hash that was recorded with it ({found}, not "
                f"{metadata['rig_hash']}): the recording is damaged, or was edited"
            )
        return dict(metadata)

    def _items(self, path: Path) -> Iterator[Any]:
        try:
            with _opened(path) as file:
                reader = StreamReader(file, validate_crcs=True, emit_chunks=True, record_size_limit=LARGEST_RECORD)
                for item in reader.records:
                    if isinstance(item, Chunk):
                        _check_size(item)
                        yield from breakup_chunk(item, validate_crc=True)
                    else:
                        yield item
        except OSError as error:
            raise RecordingError(f"{path}: {error.strerror}") from None
        except _DAMAGED:
            self.truncated = True

    def __iter__(self) -> Iterator[Recorded]:
        self.parts = []
        for path in self._files():
            self.parts.append(path)
            yield from self._messages(path)

    def _messages(self, path: Path) -> Iterator[Recorded]:
        topics: dict[int, str] = {}
        for item in self._items(path):
            if isinstance(item, Channel):
                topics[item.id] = item.topic
            elif isinstance(item, McapMessage):
                if item.channel_id not in topics:  # where its channel stood is damaged
                    self.truncated = True
                    return
                yield Recorded(topics[item.channel_id], item.log_time, item.data)

    def _files(self) -> Iterator[Path]:
        """This file, and the parts after it that are of the same control process."""
        yield self.path
        run, part = self.metadata.get("run"), self.metadata.get("part")
        if not isinstance(run, str) or not isinstance(part, int):  # written whole, or by an earlier version
            return
        for number in itertools.count(part + 1):
            path = part_path(self.path, number)
            if not path.is_file() or self._metadata(path).get("run") != run:
                return
            yield path


def _opened(path: Path) -> IO[bytes]:
    """The file, without waiting for a pipe's writer. Raises OSError, RecordingError where it is no regular file."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    file = os.fdopen(descriptor, "rb") if stat.S_ISREG(os.fstat(descriptor).st_mode) else None
    if file is None:
        os.close(descriptor)
        raise RecordingError(f"{path}: not a file but a directory, pipe or device")
    return file


def _check_size(chunk: Chunk) -> None:
    """Raise ValueError before a chunk is unpacked that no recorder writes: a few bytes can stand for gigabytes."""
    size = max(chunk.uncompressed_size, len(chunk.data))
    if chunk.compression == "zstd":
        stated = zstandard.get_frame_parameters(chunk.data).content_size
        size = max(size, 0 if stated == zstandard.CONTENTSIZE_UNKNOWN else stated)
    elif chunk.compression:
        raise ValueError(f"compression {chunk.compression}: no recorder of this project uses it")
    if size > LARGEST_CHUNK:
        raise ValueError(f"a chunk of {size} bytes")
