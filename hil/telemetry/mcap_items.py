"""The items of an MCAP file that anybody may have written: in order, in bounded memory, however the file was made.

Every length in such a file is its author's word. What is believed of it is bounded by the constants below; they are
several times what a sidecar writes. Only zstd is decompressed, as we write nothing else, and only to the size that both
the chunk and its compressed data state. A file may not unfold to more than FREELY bytes and UNFOLDING times its size: a
recording unfolds to two to ten times.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import zstandard
from mcap.exceptions import McapError
from mcap.records import Chunk
from mcap.stream_reader import StreamReader, breakup_chunk

from drivers.text_file import open_untrusted

LARGEST_FILE = 2**40  # bytes: months of four axes at 1 kHz
LARGEST_RECORD = 2**23  # bytes of any record, also of a chunk's content; the longest batch of ticks has 2 MB
FREELY, UNFOLDING = 2**24, 100
_COMPRESSIONS = ("zstd", "")


class BombError(Exception):
    """The file unfolds to more than any recording of its size does; the text says to how much."""


def mcap_items(path: Path) -> Iterator[Any]:
    """Records of the file, those in chunks among them, with their checksums checked.

    Raises OSError and drivers.text_file.UnsuitableFileError where it cannot be opened, BombError; McapError,
    ValueError, struct.error, zstandard.ZstdError where it ends too early or is damaged, as a length is that no record
    has.
    """
    with open_untrusted(path, LARGEST_FILE) as file:
        reader = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=LARGEST_RECORD)
        folded = unfolded = 0
        for item in reader.records:
            if not isinstance(item, Chunk):
                yield item
                continue
            _check(item)
            folded, unfolded = folded + len(item.data), unfolded + item.uncompressed_size
            if unfolded > FREELY + UNFOLDING * folded:
                raise BombError(f"its first {folded} bytes of content unfold to {unfolded}")
            yield from breakup_chunk(item, validate_crc=True)


def _check(chunk: Chunk) -> None:
    if chunk.compression not in _COMPRESSIONS:
        raise McapError(f"a chunk compressed by {chunk.compression[:20]!a}")
    held = zstandard.frame_content_size(chunk.data) if chunk.compression else len(chunk.data)
    if max(held, chunk.uncompressed_size) > LARGEST_RECORD or held > chunk.uncompressed_size:
        raise McapError(f"a chunk of {max(held, chunk.uncompressed_size)} bytes")
