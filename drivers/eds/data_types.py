"""Data types of CANopen objects (CiA 301, table 44): values as files write them, as Python has them, as bytes.

Rules. Numbers in files are decimal, hexadecimal (0x) or octal (a leading 0). A hexadecimal number of a signed type is
its two's complement, at the type's width or sign-extended to 32 or 64 bits. A value that its type cannot hold is none.
"""

import math
import struct
from enum import Enum, auto
from typing import NamedTuple

Value = int | float | str | bytes

LARGEST_DATA = 65536  # bytes of a string or a domain


class Kind(Enum):
    """How the bytes of a type are to be taken."""

    INTEGER = auto()
    REAL = auto()
    TEXT = auto()  # VISIBLE_STRING: one byte a character
    UNICODE = auto()  # UNICODE_STRING: two bytes a character
    DATA = auto()  # OCTET_STRING, DOMAIN


class DataType(NamedTuple):
    """One type. bits: of a number as CiA 301 has it, 0 for what has no fixed length. signed: of an integer."""

    number: int
    name: str
    kind: Kind
    bits: int = 0
    signed: bool = False

    @property
    def size(self) -> int:
        """Bytes of a number over SDO; 0 for what has no fixed length."""
        return (self.bits + 7) // 8

    @property
    def range(self) -> tuple[int, int]:
        """Least and greatest value of an integer."""
        if self.signed:
            return -(1 << self.bits - 1), (1 << self.bits - 1) - 1
        return 0, (1 << self.bits) - 1

    def parse(self, text: str, node_id: int = 0) -> Value:
        """A value as a file writes it; node_id stands in for $NODEID. Raises ValueError saying what is wrong."""
        match self.kind:
            case Kind.INTEGER:
                return self._fitted(integer(text, node_id), text)
            case Kind.REAL:
                return self._real(text)
            case Kind.TEXT | Kind.UNICODE:
                self.pack(text)
                return text
            case Kind.DATA:
                return _octets(text)

    def _fitted(self, number: int, text: str) -> int:
        """A number within the type's range; of a signed type, hexadecimal digits are two's complement."""
        low, high = self.range
        if self.signed and number > high and text.strip().lower().startswith("0x"):
            for width in (self.bits, 32, 64):
                complement = number - (1 << width)
                if low <= complement < 0:
                    return complement
        if not low <= number <= high:
            raise ValueError(f"{text[:40]} is not within {self.name}'s {low} to {high}")
        return number

    def _real(self, text: str) -> float:
        try:
            value = float(text)
            self.pack(value)
        except (ValueError, OverflowError):
            raise ValueError(f"{text[:40]!r} is no {self.name}") from None
        if not math.isfinite(value):
            raise ValueError(f"{text[:40]!r} is not finite")
        return value

    def pack(self, value: Value) -> bytes:
        """The bytes that an SDO client reads. Raises ValueError for a value of another kind, OverflowError for one that
        the type cannot hold.
        """
        if self.kind is Kind.INTEGER and isinstance(value, int):
            return value.to_bytes(self.size, "little", signed=self.signed)
        if self.kind is Kind.REAL and isinstance(value, int | float):
            return struct.pack("<f" if self.bits == 32 else "<d", value)
        if self.kind is Kind.TEXT and isinstance(value, str):
            return value.encode("latin-1")
        if self.kind is Kind.UNICODE and isinstance(value, str):
            return value.encode("utf-16-le")
        if self.kind is Kind.DATA and isinstance(value, bytes):
            return value
        raise ValueError(f"{value!r} is no {self.name}")

    def unpack(self, data: bytes) -> int | float | bytes:
        """A number of its bytes, which have to be `size` many; the bytes themselves for what has no fixed length."""
        if self.kind is Kind.INTEGER:
            return int.from_bytes(data, "little", signed=self.signed)
        if self.kind is Kind.REAL:
            return float(struct.unpack("<f" if self.bits == 32 else "<d", data)[0])
        return data


def integer(text: str, node_id: int = 0) -> int:
    """A sum of numbers and $NODEID, in any order. Raises ValueError."""
    terms = text.upper().replace("$NODEID", str(node_id)).split("+")
    try:
        return sum(map(_number, terms))
    except ValueError:
        raise ValueError(f"{text[:40]!r} is no number") from None


def _number(text: str) -> int:
    digits = text.strip().lower()
    unsigned = digits.lstrip("+-")
    if "_" in digits:  # Python's, not CiA 306's
        raise ValueError(digits)
    octal = len(unsigned) > 1 and unsigned[0] == "0" and unsigned.isdigit()
    return int(digits, 8 if octal else 16 if unsigned.startswith("0x") else 10)


def _octets(text: str) -> bytes:
    """Bytes as pairs of hexadecimal digits, with or without spaces and 0x."""
    digits = text.strip()
    try:
        return bytes.fromhex(digits[2:] if digits[:2].lower() == "0x" else digits)
    except ValueError:
        raise ValueError(f"{text[:40]!r} is no row of hexadecimal bytes") from None


def _types() -> dict[int, DataType]:
    found = {0x01: DataType(0x01, "BOOLEAN", Kind.INTEGER, 1)}
    for number, bits in {2: 8, 3: 16, 4: 32, 0x10: 24, 0x12: 40, 0x13: 48, 0x14: 56, 0x15: 64}.items():
        found[number] = DataType(number, f"INTEGER{bits}", Kind.INTEGER, bits, True)
    for number, bits in {5: 8, 6: 16, 7: 32, 0x16: 24, 0x18: 40, 0x19: 48, 0x1A: 56, 0x1B: 64}.items():
        found[number] = DataType(number, f"UNSIGNED{bits}", Kind.INTEGER, bits)
    found[0x08] = DataType(0x08, "REAL32", Kind.REAL, 32)
    found[0x11] = DataType(0x11, "REAL64", Kind.REAL, 64)
    found[0x09] = DataType(0x09, "VISIBLE_STRING", Kind.TEXT)
    found[0x0A] = DataType(0x0A, "OCTET_STRING", Kind.DATA)
    found[0x0B] = DataType(0x0B, "UNICODE_STRING", Kind.UNICODE)
    for number, name in {0x0C: "TIME_OF_DAY", 0x0D: "TIME_DIFFERENCE"}.items():  # milliseconds in 28 bits, days in 16
        found[number] = DataType(number, name, Kind.INTEGER, 48)
    found[DOMAIN] = DataType(DOMAIN, "DOMAIN", Kind.DATA)
    return found


DOMAIN = 0x0F
UNSIGNED8 = 0x05
DATA_TYPES: dict[int, DataType] = _types()
