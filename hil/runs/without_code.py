"""A copy of a recording without the source of laws and other plug-ins that it carries, for people who are to see the
run and not the code.
"""

import dataclasses
import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

from google.protobuf.message import DecodeError
from mcap.records import Attachment, Channel, Message, Metadata

from drivers.base.plugins import DIGEST
from drivers.base.text_file import UnsuitableFileError, open_untrusted
from hil.rig.file import document_hash
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.mcap_items import LARGEST_FILE, BombError, McapItems
from hil.telemetry.recording import RUN_ATTACHMENT, Recording, RecordingError, topic_of
from hil.telemetry.recover import recover

_LEFT_OUT = "# left out when this run was shared; the text had the digest "


class _Stripped:
    """Makes of the items of a file those of its copy. found: the keys that had a source, such as law.source."""

    def __init__(self) -> None:
        self.found: set[str] = set()
        self._topics: dict[int, str] = {}
        self._rig_hash = ""

    def __call__(self, item: Any) -> Any:
        """Raises ValueError where it cannot be seen whether the item holds any."""
        if isinstance(item, Channel):
            self._topics[item.id] = item.topic
        elif isinstance(item, Attachment) and item.name == RUN_ATTACHMENT:
            return dataclasses.replace(item, data=self._description(item.data))
        elif isinstance(item, Metadata) and "rig_hash" in item.metadata and self._rig_hash:
            return dataclasses.replace(item, metadata={**item.metadata, "rig_hash": self._rig_hash})
        elif (
            isinstance(item, Message) and (self._topics.get(item.channel_id) or topic_of(item.channel_id)) == "commands"
        ):
            return dataclasses.replace(item, data=self._command(item.data))
        return item

    def _description(self, data: bytes) -> bytes:
        document = _parsed(data)
        self.found |= _strip(document["rig"])
        self._rig_hash = document["rig_hash"] = document_hash(document["rig"])
        return json.dumps(document).encode()

    def _command(self, data: bytes) -> bytes:
        try:
            entry = pb.CommandEntry.FromString(data)
        except DecodeError as error:
            raise ValueError(str(error)) from None
        if not entry.task:
            return data
        task = _parsed(entry.task)
        if not (keys := _strip(task, "task.")):
            return data
        self.found |= keys
        entry.task = json.dumps(task).encode()
        return entry.SerializeToString()


def _parsed(data: bytes) -> dict[str, Any]:
    try:
        found = json.loads(data)
    except RecursionError:
        raise ValueError("a document of too many levels") from None
    if not isinstance(found, dict):
        raise ValueError("no document")
    return found


def _strip(document: dict[str, Any], within: str = "") -> set[str]:
    """Replace every text of code by its digest; the keys that had one."""
    found: set[str] = set()
    for key, value in document.items():
        if isinstance(value, dict):
            found |= _strip(value, f"{within}{key}.")
        elif key == "source" and isinstance(value, str) and value and not value.startswith(DIGEST):
            document[key] = _LEFT_OUT + DIGEST + hashlib.sha256(value.encode(errors="surrogatepass")).hexdigest()
            found.add(f"{within}{key}")
    return found


def carried_sources(path: Path) -> tuple[set[str], bool]:
    """(keys of the rig and of loaded tasks whose code a recording carries, whether the file is whole).

    Raises RecordingError where it is no recording.
    """
    Recording(path)
    stripped, items = _Stripped(), McapItems(path)
    whole = True
    try:
        for item in items:
            try:
                stripped(item)
            except (ValueError, KeyError, TypeError, AttributeError):
                whole = False
    except (UnsuitableFileError, BombError) as error:
        raise RecordingError(f"{path}: not a recording of a control process: {error}") from None
    return stripped.found, whole and not items.damaged


def files_of(path: Path) -> list[str]:
    """Names of the files whose texts a recording carries: a DBC file, EDS files. Raises RecordingError."""
    files = Recording(path).metadata.get("files")
    return sorted(files) if isinstance(files, dict) else []


def copy_without_code(path: Path, target: Path) -> None:
    """Copy a recording without any source, byte for byte where it carries none and is whole. Raises RecordingError,
    OSError.
    """
    found, whole = carried_sources(path)
    if found or not whole:  # what is damaged may hold anything
        recover(path, target, _Stripped())
        return
    try:
        with open_untrusted(path, LARGEST_FILE) as file, target.open("xb") as copy:
            shutil.copyfileobj(file, copy)
    except UnsuitableFileError as error:
        raise RecordingError(f"{path}: {error}") from None
