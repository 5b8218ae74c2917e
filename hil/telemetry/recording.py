"""Reads recordings (recorder.py), of today's layout and the earlier one, cut short or damaged or not.

What is damaged is left out; `Gaps` counts which ticks that took.
"""

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Attachment, Channel
from mcap.records import Message as McapMessage

from drivers.base.text_file import UnsuitableFileError, printable, words_of
from hil.rig.file import document_hash
from hil.telemetry.mcap_items import BombError, McapItems

RUN_ATTACHMENT = "run.json"
# Of every recorder, in the order of their channels, which begin with 1: for a file whose own list is damaged.
TOPICS = ("tick", "cycle", "status", "commands", "events")
_PART = re.compile(r"\.part-\d+$")


class RecordingError(Exception):
    """The file is no recording of a control process, or none can be written."""


class Recorded(NamedTuple):
    """A message of a recording. time_ns: wall clock."""

    topic: str
    time_ns: int
    data: bytes


def topic_of(channel: int) -> str:
    """The topic that a recorder gives a channel, where the file's own list of them is damaged; empty for others."""
    return TOPICS[channel - 1] if 0 < channel <= len(TOPICS) else ""


class Gap(NamedTuple):
    """Ticks that are missing. after: ring index of the last one before them, -1 where there is none."""

    after: int
    ticks: int


class Gaps:
    """Which ticks are missing, by the ring indices of those that are there."""

    def __init__(self) -> None:
        self.found: list[Gap] = []
        self._next: int | None = None

    def add(self, first: int, ticks: int, lost: int, *, damaged: bool) -> None:
        """Ticks in their order. first: ring index. lost: missing before them, as the recorder knew. damaged: something
        in the file before them is.
        """
        if self._next is None:
            self._next = 0 if damaged else max(0, first - lost)
        if first > self._next:
            self.found.append(Gap(self._next - 1, first - self._next))
        self._next = max(self._next, first + ticks)

    @property
    def ticks(self) -> int:
        """How many are missing in all."""
        return sum(gap.ticks for gap in self.found)


def loss_text(gaps: Sequence[Gap], period_s: float, *, damaged: bool, most: int = 5) -> str:
    """What is missing, in ticks and seconds, for people; empty where nothing is. most: gaps that are named."""
    if not gaps:
        return "the file is damaged or was cut short; what it lost behind its last whole chunk is not known" * damaged
    total = sum(gap.ticks for gap in gaps)
    named = [
        f"{gap.ticks} after tick {gap.after}" if gap.after >= 0 else f"the first {gap.ticks}" for gap in gaps[:most]
    ]
    more = f", and {len(gaps) - most} more gaps" if len(gaps) > most else ""
    why = "the file is damaged or was cut short" if damaged else "the recorder could not keep up"
    return f"{total} ticks ({total * period_s:.3f} s) are missing: {', '.join(named)}{more}; {why}"


def part_path(path: Path, number: int) -> Path:
    """Where part `number` (2, 3, ...) of the recording is that `path` is a part of. Names sort as the parts do; earlier
    versions wrote the number without zeros.
    """
    return path.with_name(f"{_stem(path)}.part-{number:04}.mcap")


def _stem(path: Path) -> str:
    return _PART.sub("", path.name.removesuffix(".mcap"))


def first_part(path: Path) -> Path:
    """Where the first file of the recording is that `path` is a later part of; `path` itself where it is none."""
    return path.with_name(f"{_stem(path)}.mcap") if _PART.search(path.name.removesuffix(".mcap")) else path


class Recording:
    """Reads a recording from front to end, cut short or damaged or not, and on through the parts that follow it.

    path: the file. metadata: what its `run.json` holds. truncated: set once iteration has met the end of a file that
    was cut short, or a record that is damaged, which it leaves out. parts: files met by iteration. Raises
    RecordingError when the file is none.
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
            if isinstance(item, McapMessage) and not self.truncated:
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
        return {key: printable(value) if isinstance(value, str) else value for key, value in metadata.items()}

    def _items(self, path: Path) -> Iterator[Any]:
        items = McapItems(path)
        try:
            for item in items:
                self.truncated |= items.damaged
                yield item
        except OSError as error:
            raise RecordingError(f"{path}: {words_of(error)}") from None
        except (UnsuitableFileError, BombError) as error:
            raise RecordingError(f"{path}: not a recording of a control process: {error}") from None
        self.truncated |= items.damaged

    def __iter__(self) -> Iterator[Recorded]:
        self.parts, self.truncated = [], False
        for path in self._files():
            self.parts.append(path)
            yield from self._messages(path)

    def _messages(self, path: Path) -> Iterator[Recorded]:
        topics: dict[int, str] = {}
        for item in self._items(path):
            if isinstance(item, Channel):
                topics[item.id] = item.topic
            elif isinstance(item, McapMessage):
                topic = topics.get(item.channel_id) or topic_of(item.channel_id)
                if topic:
                    yield Recorded(topic, item.log_time, item.data)

    def _files(self) -> Iterator[Path]:
        """This file, and the parts after it that are of the same control process."""
        yield self.path
        run, part = self.metadata.get("run"), self.metadata.get("part")
        if not isinstance(run, str) or not isinstance(part, int):  # written whole, or by an earlier version
            return
        stem = f"{_stem(self.path)}.part-"
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
