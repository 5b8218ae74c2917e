"""The items of an MCAP file that anybody may have written: in order, in bounded memory, however the file was made.

Every length in such a file is its author's word. What is believed of it is bounded by the constants below; they are
several times what a sidecar writes. Only zstd is decompressed, as we write nothing else, and only to the size that both
the chunk and its compressed data state. A file may not unfold to more than FREELY bytes and UNFOLDING times its size: a
recording unfolds to two to ten times.

A record that is damaged is left out, and reading goes on with the next chunk: of a chunk the checksum says whether it
is whole, and its header can be told from anything else.
"""

import io
import os
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk

from drivers.base.text_file import open_untrusted

LARGEST_FILE = 2**40  # bytes: months of four axes at 1 kHz
LARGEST_RECORD = 2**23  # bytes of any record, also of a chunk's content; the longest batch of ticks has 2 MB
FREELY, UNFOLDING = 2**24, 100
_COMPRESSIONS = ("zstd", "")
# What a record that has any bit wrong can cause: a length may be beyond all bounds.
DAMAGED = (McapError, ValueError, struct.error, zstandard.ZstdError, OverflowError, MemoryError)

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
# What is found again behind damage: chunks, by their compression's name, and the description of the run, by its own.
_MARKS = re.compile(rb"\x04\0\0\0zstd|\x08\0\0\0run\.json")
_MARK_AT = {b"z": (Opcode.CHUNK, 9 + 28), b"r": (Opcode.ATTACHMENT, 9 + 16)}  # by its name's first letter
_LONGEST_MARK = 12
_BLOCK = 2**20
_MOST_TRIES = 1000  # places that look like a chunk and are none
_READ: dict[int, Callable[[ReadDataStream], Any]] = {
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.METADATA: Metadata.read,
    Opcode.DATA_END: DataEnd.read,
    Opcode.FOOTER: Footer.read,
}
_IGNORED = (
    Opcode.HEADER, Opcode.MESSAGE_INDEX, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.STATISTICS,
    Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET,
)  # fmt: skip


class BombError(Exception):
    """The file unfolds to more than any recording of its size does; the text says to how much."""


class _Record(NamedTuple):
    items: list[Any]
    end: int  # offset in the file
    folded: int = 0
    unfolded: int = 0


class _Bytes(ReadDataStream):
    """A record's content; what is not all there raises."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise McapError("a record that ends early")
        return data


class McapItems:
    """Iterates over the records of the file, those in chunks among them, with their checksums checked.

    damaged: set once iteration has met a record that is not whole, or the end of a file that was cut short.
    Iteration raises OSError and drivers.base.text_file.UnsuitableFileError where the file cannot be opened, BombError.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._tries = 0
        self.damaged = False

    def __iter__(self) -> Iterator[Any]:
        with open_untrusted(self._path, LARGEST_FILE) as file:
            size = os.fstat(file.fileno()).st_size
            self.damaged = file.read(len(_MAGIC)) != _MAGIC
            at: int | None = len(_MAGIC)
            if self.damaged:
                at = self._next_whole(file, 0, size)
            folded = unfolded = 0
            while at is not None:
                record = self._record(file, at, size)
                if record is None:
                    self.damaged = True
                    at = self._next_whole(file, at + 1, size)
                    continue
                folded, unfolded = folded + record.folded, unfolded + record.unfolded
                if unfolded > FREELY + UNFOLDING * folded:
                    raise BombError(f"its first {folded} bytes of content unfold to {unfolded}")
                yield from record.items
                at = record.end
                if record.items and isinstance(record.items[0], Footer):
                    return

    def _record(self, file: BinaryIO, at: int, size: int) -> _Record | None:
        """That which begins at an offset; None where none does that is whole."""
        file.seek(at)
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return None
        kind, length = _HEAD.unpack(head)
        end = at + _HEAD.size + length
        if length > LARGEST_RECORD or end > size or not (kind in _READ or kind in _IGNORED or kind == Opcode.MESSAGE):
            return None
        try:
            return _parsed(kind, file.read(length), end)
        except DAMAGED:
            return None

    def _next_whole(self, file: BinaryIO, start: int, size: int) -> int | None:
        """Offset of the next chunk, or description of the run, that is whole."""
        place = start
        while place < size and self._tries < _MOST_TRIES:
            file.seek(place)
            block = file.read(_BLOCK)
            for found in _MARKS.finditer(block):
                kind, before = _MARK_AT[found[0][4:5]]
                at = place + found.start() - before
                if at >= start and self._tries < _MOST_TRIES and self._is_whole(file, at, size, kind):
                    return at
            place += max(1, len(block) - _LONGEST_MARK + 1)
        return None

    def _is_whole(self, file: BinaryIO, at: int, size: int, kind: int) -> bool:
        file.seek(at)
        if file.read(1) != bytes([kind]):
            return False
        self._tries += 1
        record = self._record(file, at, size)
        self._tries -= record is not None
        return record is not None


def _parsed(kind: int, data: bytes, end: int) -> _Record:
    """A record's items. Raises one of DAMAGED."""
    if kind == Opcode.MESSAGE_INDEX and len(data) != 6 + int.from_bytes(data[2:6], "little"):
        raise McapError("a message index of another length")
    if kind in _IGNORED:
        return _Record([], end)
    stream = _Bytes(io.BytesIO(data))
    item = Message.read(stream, len(data)) if kind == Opcode.MESSAGE else _READ[kind](stream)
    if stream.count != len(data):
        raise McapError("a record of another length")
    if isinstance(item, Attachment) and (crc := int.from_bytes(data[-4:], "little")) and crc != zlib.crc32(data[:-4]):
        raise McapError("an attachment whose checksum does not hold")
    if not isinstance(item, Chunk):
        return _Record([item], end)
    _check(item)
    return _Record(breakup_chunk(item, validate_crc=True), end, len(item.data), item.uncompressed_size)


def _check(chunk: Chunk) -> None:
    if chunk.compression not in _COMPRESSIONS:
        raise McapError(f"a chunk compressed by {chunk.compression[:20]!a}")
    held = zstandard.frame_content_size(chunk.data) if chunk.compression else len(chunk.data)
    if max(held, chunk.uncompressed_size) > LARGEST_RECORD or held > chunk.uncompressed_size:
        raise McapError(f"a chunk of {max(held, chunk.uncompressed_size)} bytes")
