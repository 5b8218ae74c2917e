"""How drives of the MIT kind pack positions and torques, and what they are told: one class a maker.

Sources: Damiao, "DM-J4310-2EC V1.1 motor user guide" (MIT mode); CubeMars, "AK series module driver user manual",
5.3 (MIT mode); RobStride, "RS01 user manual" (private protocol, communication types 1 to 4). A value of `bits` bits
goes evenly from the least (all zeros) to the greatest of its range (all ones), big-endian.
"""

from typing import Final, NamedTuple, Protocol

from drivers.frame import EXTENDED, Frame
from drivers.protocols.base import UNHEALTHY, DriveStatus

POSITION_BITS: Final = 16
_MIDDLE_12, _MIDDLE_16 = 0x7FF, 0x7FFF  # zero, but for half a step
_START, _STOP, _CLEAR = 0xFC, 0xFD, 0xFB
_TYPE_CONTROL, _TYPE_ANSWER, _TYPE_START, _TYPE_STOP = 1, 2, 3, 4
_ENABLED, _FAULT = int(DriveStatus.ENABLED), int(DriveStatus.FAULT)
_WATCHDOG, _ENCODER = int(DriveStatus.WATCHDOG), int(DriveStatus.ENCODER_FAULT)
_BAD = int(UNHEALTHY)


class Answer(NamedTuple):
    """node: number of the drive. raw: its position. status: DriveStatus bits; -1: a value that the maker has not."""

    node: int
    raw: int
    status: int


class Packing(Protocol):
    """A maker's frames. own_mask, answer_mask: bits of an identifier that tell a command, an answer. node_mask: those
    that tell whom a frame of the host is for. states, tells: as a layout has them.
    """

    torque_bits: int
    states: bool
    tells: int
    own_mask: int
    node_mask: int
    answer_mask: int

    def apply(self, node: int, raw: int) -> Frame:
        """Apply the torque `raw`; all gains zero."""

    def start(self, node: int) -> Frame:
        """Switch the power stage on."""

    def stop(self, node: int) -> Frame:
        """Switch it off."""

    def clear(self, node: int) -> Frame:
        """Switch it off and end what it has latched."""

    def answer_id(self, node: int, answers: int) -> int:
        """Identifier of its answers, as shown to people."""

    def is_answer(self, can_id: int) -> bool:
        """Whether a drive of ours may have sent this identifier."""

    def read(self, frame: Frame) -> Answer:
        """Value of an answer of eight bytes."""

    def answer(self, node: int, can_id: int, raw: int, status: int) -> Frame:
        """An answer that says that; at rest, no torque, 25 deg C."""


class Damiao:
    """Position 16, speed 12, gains 12 and 12, torque 12 bits; state and causes in the upper half of the first byte."""

    torque_bits, states, own_mask, answer_mask, node_mask = 12, True, -1, -1, -1
    tells = int(DriveStatus.ENABLED | DriveStatus.FAULT | DriveStatus.WATCHDOG)

    def __init__(self, answers: frozenset[int]) -> None:
        self._answers = answers

    def apply(self, node: int, raw: int) -> Frame:
        """Speed in the middle, no gains."""
        return Frame(node, bytes((0x7F, 0xFF, _MIDDLE_12 >> 4, (_MIDDLE_12 & 0xF) << 4, 0, 0, raw >> 8, raw & 0xFF)))

    def start(self, node: int) -> Frame:
        """Enable."""
        return _order(node, _START)

    def stop(self, node: int) -> Frame:
        """Disable."""
        return _order(node, _STOP)

    def clear(self, node: int) -> Frame:
        """Clear the error."""
        return _order(node, _CLEAR)

    def answer_id(self, node: int, answers: int) -> int:
        """As the drive is set."""
        return answers

    def is_answer(self, can_id: int) -> bool:
        """By its identifier alone."""
        return can_id in self._answers

    def read(self, frame: Frame) -> Answer:
        """ERR: 0 disabled, 1 enabled, 8 to E what is wrong (D: nobody spoke to it)."""
        data = frame.data
        code = data[0] >> 4
        status = -1
        if code <= 1:
            status = _ENABLED if code else 0
        elif code == 0xD:
            status = _WATCHDOG
        elif 8 <= code <= 0xE:
            status = _FAULT
        return Answer(data[0] & 0xF, data[1] << 8 | data[2], status)

    def answer(self, node: int, can_id: int, raw: int, status: int) -> Frame:
        """Any fault but its timeout as an overload."""
        code = 0xD if status & _WATCHDOG else 0xE if status & _BAD else status & _ENABLED
        return _twelve_bits(can_id, code << 4 | node & 0xF, raw, 25)


class CubeMars(Damiao):
    """The same frames; the last byte of an answer is the cause. No answer says whether the power stage is on, and no
    order ends an error but a new start.
    """

    states, tells = False, int(DriveStatus.FAULT | DriveStatus.ENCODER_FAULT)

    def clear(self, node: int) -> Frame:
        """It leaves motor mode."""
        return _order(node, _STOP)

    def read(self, frame: Frame) -> Answer:
        """Error 0: none, 1 to 7: what is wrong (5: the encoder)."""
        data = frame.data
        code = data[7]
        status = -1
        if code == 0:
            status = 0
        elif code == 5:
            status = _FAULT | _ENCODER
        elif code <= 7:
            status = _FAULT
        return Answer(data[0], data[1] << 8 | data[2], status)

    def answer(self, node: int, can_id: int, raw: int, status: int) -> Frame:
        """Any fault but the encoder's as one of the current."""
        return _twelve_bits(can_id, node, raw, 5 if status & _ENCODER else 2 if status & _BAD else 0)


class RobStride:
    """Extended identifiers: type in bits 24 to 28, the torque of a command in bits 8 to 23, number in bits 0 to 7. An
    answer has number, faults (bits 16 to 21) and mode (22, 23) there.
    """

    torque_bits, states = 16, True
    own_mask, answer_mask, node_mask = 0x1F0000FF | EXTENDED, 0x1F00FFFF | EXTENDED, 0xFF | EXTENDED
    tells = int(DriveStatus.ENABLED | DriveStatus.FAULT | DriveStatus.ENCODER_FAULT)

    def __init__(self, host: int, nodes: frozenset[int]) -> None:
        self._host, self._nodes = host, nodes

    def apply(self, node: int, raw: int) -> Frame:
        """Type 1: position, speed, gains in the data."""
        can_id = EXTENDED | _TYPE_CONTROL << 24 | raw << 8 | node
        return Frame(can_id, bytes((0x7F, 0xFF, _MIDDLE_16 >> 8, _MIDDLE_16 & 0xFF, 0, 0, 0, 0)))

    def start(self, node: int) -> Frame:
        """Type 3."""
        return self._order(_TYPE_START, node, 0)

    def stop(self, node: int) -> Frame:
        """Type 4."""
        return self._order(_TYPE_STOP, node, 0)

    def clear(self, node: int) -> Frame:
        """Type 4 with a one ends faults, too."""
        return self._order(_TYPE_STOP, node, 1)

    def _order(self, kind: int, node: int, first: int) -> Frame:
        return Frame(EXTENDED | kind << 24 | self._host << 8 | node, bytes((first, 0, 0, 0, 0, 0, 0, 0)))

    def answer_id(self, node: int, answers: int) -> int:
        """Without a fault, enabled."""
        return EXTENDED | _TYPE_ANSWER << 24 | 2 << 22 | node << 8 | self._host

    def is_answer(self, can_id: int) -> bool:
        """Type 2 to this host, from a drive that we have."""
        if can_id & ~0x00FFFF00 != EXTENDED | _TYPE_ANSWER << 24 | self._host:
            return False
        return can_id >> 8 & 0xFF in self._nodes

    def read(self, frame: Frame) -> Answer:
        """Mode 0: reset, 1: calibrating, 2: running. Bit 3 of the faults: the magnetic encoder."""
        can_id, data = frame.can_id, frame.data
        faults, mode = can_id >> 16 & 0x3F, can_id >> 22 & 3
        status = _ENABLED if mode == 2 else 0
        if mode == 3:
            status = -1
        elif faults:
            status = _FAULT | (_ENCODER if faults & 8 else 0)
        return Answer(can_id >> 8 & 0xFF, data[0] << 8 | data[1], status)

    def answer(self, node: int, can_id: int, raw: int, status: int) -> Frame:
        """Any fault but the encoder's as one of the current."""
        faults = 8 if status & _ENCODER else 2 if status & _BAD else 0
        mode = 2 if status & _ENABLED else 0
        can_id = EXTENDED | _TYPE_ANSWER << 24 | mode << 22 | faults << 16 | node << 8 | self._host
        return Frame(can_id, bytes((raw >> 8, raw & 0xFF, 0x7F, 0xFF, 0x7F, 0xFF, 0, 250)))


def _order(node: int, code: int) -> Frame:
    return Frame(node, b"\xff\xff\xff\xff\xff\xff\xff" + bytes((code,)))


def _twelve_bits(can_id: int, first: int, raw: int, last: int) -> Frame:
    """Position, and speed and torque in the middle of their ranges."""
    return Frame(can_id, bytes((first, raw >> 8, raw & 0xFF, 0x7F, 0xF7, 0xFF, 25, last)))
