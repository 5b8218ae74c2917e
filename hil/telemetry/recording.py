"""Reads recordings (recorder.py), of today's layout and the earlier one, cut short or damaged or not."""

import json
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import zstandard
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel
from mcap.records import Message as McapMessage

from drivers.text_file import UnsuitableFileError
from hil.rig.file import document_hash
from hil.telemetry.mcap_items import BombError, mcap_items

RUN_ATTACHMENT = "run.json"
_PART = re.compile(r"\.part-\d+$")
# What a file that ends anywhere, or has any bit wrong, can cause: a length may be beyond all bounds.
DAMAGED = (McapError, ValueError, struct.error, zstandard.ZstdError, OverflowError, MemoryError)


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
            found = document_hash(metadata["rig"])
        except (ValueError, KeyError, TypeError, RecursionError):  # TypeError: it is no object
            known = False
        if not known:
            raise RecordingError(f"{path}: its description ({RUN_ATTACHMENT}) is damaged")
        if found != metadata["rig_hash"]:  # a cycle of another rig would be blamed for its other torques
            raise RecordingError(
                f"{path}: its rig does not have the hash that was recorded with it ({found}, not "
                f"{metadata['rig_hash']}): the recording is damaged, or was edited"
            )
        return dict(metadata)

    def _items(self, path: Path) -> Iterator[Any]:
        try:
            yield from mcap_items(path)
        except OSError as error:
            raise RecordingError(f"{path}: {error.strerror}") from None
        except (UnsuitableFileError, BombError) as error:
            raise RecordingError(f"{path}: not a recording of a control process: {error}") from None
        except DAMAGED:
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
        stem = part_path(self.path, 0).name.removesuffix("0.mcap")
        numbers = {path: path.name.removeprefix(stem).removesuffix(".mcap") for path in self.path.parent.glob("*.mcap")}
        parts = {
            int(number): path for path, number in numbers.items() if path.name.startswith(stem) and number.isdigit()
        }
        for _, path in sorted((number, path) for number, path in parts.items() if number > part):
            try:
                follows = self._metadata(path).get("run") == run
            except RecordingError:  # a sidecar was killed before it had said whose it is
                continue
            if follows:
                yield path
