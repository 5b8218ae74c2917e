"""The register protocol of moteus controllers: subframes of a CAN FD frame as values, and back.

Source: moteus' documentation, pages "CAN Protocol" and "Register Reference" (github.com/mjbots/moteus, docs/protocol).
A frame holds subframes: a byte of operation, type and count, the first register, and for writes and replies the values,
little-endian. Integers are steps of a unit that depends on the register; the least integer and NaN mean "none".
"""

import math
from enum import IntEnum
from struct import Struct
from typing import NamedTuple

from drivers.frame import FD_LENGTHS


class Register(IntEnum):
    """Those that a torque rig uses."""

    MODE = 0x000
    POSITION = 0x001
    VELOCITY = 0x002
    TORQUE = 0x003
    TEMPERATURE = 0x00E
    FAULT = 0x00F
    COMMAND_POSITION = 0x020
    COMMAND_VELOCITY = 0x021
    FEEDFORWARD_TORQUE = 0x022
    KP_SCALE = 0x023
    KD_SCALE = 0x024
    WATCHDOG_TIMEOUT = 0x027
    ILIMIT_SCALE = 0x02B
    AUX1_GPIO_STATUS = 0x05E
    AUX2_GPIO_STATUS = 0x05F


class Mode(IntEnum):
    """Register 000h."""

    STOPPED = 0
    FAULT = 1
    POSITION = 10
    TIMEOUT = 11


class Type(IntEnum):
    """How values are sent: bits 2 and 3 of a subframe's first byte."""

    INT8 = 0
    INT16 = 1
    INT32 = 2
    FLOAT = 3


WRITE, READ, REPLY = 0x00, 0x10, 0x20
WRITE_ERROR, READ_ERROR, NOP = 0x30, 0x31, 0x50
BITS = {Type.INT8: 8, Type.INT16: 16, Type.INT32: 32}
_NUMBER = {Type.INT8: Struct("<b"), Type.INT16: Struct("<h"), Type.INT32: Struct("<i"), Type.FLOAT: Struct("<f")}

_SCALE = (1 / 127, 1 / 32767, 1 / 2147483647)
_POSITION, _VELOCITY, _TORQUE = (0.01, 1e-4, 1e-5), (0.1, 2.5e-4, 1e-5), (0.5, 0.01, 0.001)
STEPS: dict[int, tuple[float, float, float]] = {  # of int8, int16 and int32; a register that is not here counts in ones
    Register.POSITION: _POSITION,
    Register.VELOCITY: _VELOCITY,
    Register.TORQUE: _TORQUE,
    Register.TEMPERATURE: (1.0, 0.1, 0.001),
    Register.COMMAND_POSITION: _POSITION,
    Register.COMMAND_VELOCITY: _VELOCITY,
    Register.FEEDFORWARD_TORQUE: _TORQUE,
    Register.KP_SCALE: _SCALE,
    Register.KD_SCALE: _SCALE,
    Register.ILIMIT_SCALE: _SCALE,
    Register.WATCHDOG_TIMEOUT: (0.01, 0.001, 1e-6),
}


def step_of(register: int, kind: Type) -> float:
    """What an integer of this type counts in, in turns, turns/s, N m, s, degrees C or 1; 1 for a float."""
    return 1.0 if kind is Type.FLOAT else STEPS.get(register, (1.0, 1.0, 1.0))[kind]


class Value(NamedTuple):
    """One register in a frame. operation: WRITE, READ, REPLY, WRITE_ERROR or READ_ERROR. raw: as sent; of a READ 0, of
    an error its number.
    """

    operation: int
    register: int
    kind: Type
    raw: float

    @property
    def number(self) -> float:
        """In turns, turns/s, N m, s, degrees C or 1; NaN for none."""
        if self.kind is Type.FLOAT:
            return self.raw
        if self.raw == -(1 << (BITS[self.kind] - 1)):
            return math.nan
        return self.raw * step_of(self.register, self.kind)


def write(register: int, kind: Type, *raws: float) -> bytes:
    """Subframe that writes one to three registers from `register` on, raw values. Raises struct.error beyond them."""
    return bytes((WRITE | kind << 2 | len(raws), register)) + b"".join(_NUMBER[kind].pack(raw) for raw in raws)


def read(register: int, kind: Type, count: int = 1) -> bytes:
    """Subframe that asks for one to three registers from `register` on."""
    return bytes((READ | kind << 2 | count, register))


def padded(data: bytes) -> bytes:
    """Data of a frame that is as long as an FD frame may be. Raises ValueError beyond 64 bytes."""
    for length in FD_LENGTHS:
        if length >= len(data):
            return data + bytes((NOP,)) * (length - len(data))
    raise ValueError(f"{len(data)} bytes: an FD frame has at most {FD_LENGTHS[-1]}")


def parse(data: bytes) -> list[Value]:
    """All registers of a frame. Raises ValueError where it is none of this protocol, or cut short."""
    values: list[Value] = []
    at = 0
    try:
        while at < len(data):
            head = data[at]
            at += 1
            if head == NOP:
                continue
            if head in (WRITE_ERROR, READ_ERROR):
                register, at = _varuint(data, at)
                number, at = _varuint(data, at)
                values.append(Value(head, register, Type.INT32, number))
                continue
            operation, kind, count = head & 0xF0, Type(head >> 2 & 3), head & 3
            if operation not in (WRITE, READ, REPLY):
                raise ValueError(f"subframe {head:02X}h")
            if not count:
                count, at = _varuint(data, at)
            register, at = _varuint(data, at)
            if count > len(data):
                raise ValueError(f"{count} registers in {len(data)} bytes")
            form = _NUMBER[kind]
            for number in range(count):
                if operation == READ:
                    values.append(Value(READ, register + number, kind, 0))
                    continue
                if at + form.size > len(data):
                    raise ValueError("cut short")
                values.append(Value(operation, register + number, kind, form.unpack_from(data, at)[0]))
                at += form.size
    except IndexError:
        raise ValueError("cut short") from None
    return values


def _varuint(data: bytes, at: int) -> tuple[int, int]:
    """A number of up to five bytes, seven bits each, and where it ends. Raises IndexError, ValueError."""
    number = 0
    for shift in range(0, 35, 7):
        byte = data[at]
        at += 1
        number |= (byte & 0x7F) << shift
        if byte < 0x80:
            return number, at
    raise ValueError("a number of more than five bytes")
