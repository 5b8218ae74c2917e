"""The bytes of ROS 2 messages: plain CDR, little-endian. A message is a dict by field name."""

import struct
from typing import Any, Final

from hil.adapters.ros_types import BASIC, TYPES

Message = dict[str, Any]
MOST: Final = 1_000_000  # items that a sequence from elsewhere may announce
_HEADER: Final = b"\x00\x01\x00\x00"


def encode(name: str, message: Message) -> bytes:
    """The bytes of a message; fields that it lacks are zero or empty. Raises struct.error for what does not fit."""
    out = bytearray()
    _put(out, name, message)
    return _HEADER + bytes(out)


def _put(out: bytearray, kind: str, value: Any) -> None:
    if kind == "string":
        data = value.encode() + b"\0"
        _put(out, "uint32", len(data))
        out += data
    elif kind in BASIC:
        letter = BASIC[kind][0]
        out += bytes(-len(out) % struct.calcsize(letter)) + struct.pack("<" + letter, value)
    else:
        for field, (inner, shape, size) in TYPES[kind].items():
            items = value.get(field, _empty(inner, shape, size))
            if shape in ("sequence", "bounded"):
                _put(out, "uint32", len(items))
            for item in items if shape else [items]:
                _put(out, inner, item)


def _empty(kind: str, shape: str, size: int) -> Any:
    zero: Any = "" if kind == "string" else 0 if kind in BASIC else {}
    return [zero] * size if shape == "array" else [] if shape else zero


def decode(name: str, data: bytes) -> Message:
    """The message of these bytes. Raises ValueError for what is none."""
    if data[:2] != _HEADER[:2]:
        raise ValueError(f"no plain little-endian CDR: it begins with {data[:2].hex()}")
    try:
        message, _ = _take(data[4:], 0, name)
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError(f"no {name}: {error}") from None
    assert isinstance(message, dict)
    return message


def _take(data: bytes, at: int, kind: str) -> tuple[Any, int]:
    if kind == "string":
        length, at = _take(data, at, "uint32")
        if not 0 < length <= len(data) - at:
            raise ValueError(f"a string of {length} bytes, where {len(data) - at} are left")
        return data[at : at + length - 1].decode(), at + length
    if kind in BASIC:
        letter = BASIC[kind][0]
        size = struct.calcsize(letter)
        at += -at % size
        return struct.unpack_from("<" + letter, data, at)[0], at + size
    message: Message = {}
    for field, (inner, shape, size) in TYPES[kind].items():
        count = size if shape == "array" else 1
        if shape in ("sequence", "bounded"):
            count, at = _take(data, at, "uint32")
            if count > min(MOST, len(data)):
                raise ValueError(f"{field}: {count} items in {len(data)} bytes")
        items = []
        for _ in range(count):
            item, at = _take(data, at, inner)
            items.append(item)
        message[field] = items if shape else items[0]
    return message, at
