"""What of an answer is believed, and within which bounds: the same fields for every layout.

A layout declares what it carries (drivers.protocols.base.HostProtocol); here is what follows. Which fault tells of a
field is written in the fault's row (hil/cycle/faults), what a wrong one comes to in the campaign
(hil/studies/fault_campaign/answer_fields.py). docs/answers.md shows all three.
"""

from enum import Enum
from typing import NamedTuple

from drivers.protocols.base import DriveStatus, HostProtocol

_ROUNDED = 100_000  # counts: beyond it a range is shown in powers


class Field(Enum):
    """A part of an answer."""

    IDENTIFIER = "identifier"
    SENDER = "sender"
    COUNT = "count per command"
    SEQUENCE = "sequence"
    POSITION = "position"
    STAMP = "stamp"
    STATUS = "status"
    CAUSES = "causes"
    LENGTH = "length"
    CHECKSUM = "checksum"


class Bound(NamedTuple):
    """How far a field is believed. carried: it is there at all. bound: within what. outside: what happens beyond."""

    carried: bool
    bound: str
    outside: str


_DROPPED = "no sample; counted"
_NOT_CARRIED = "the layout carries none"


def bounds_of(layout: HostProtocol) -> dict[Field, Bound]:
    """Of every field of a layout's answers, for people."""
    return {
        Field.IDENTIFIER: Bound(True, "one of the layout's own", f"{_DROPPED} as unknown_id"),
        Field.SENDER: Bound(True, "of a command, SYNC or NMT: this host alone", "latched at the first frame"),
        Field.COUNT: _count(layout),
        Field.SEQUENCE: _sequence(layout),
        Field.POSITION: Bound(True, f"{_range(layout)}; a step within the axis' speed bound", "the sample is not used"),
        Field.STAMP: _stamp(layout),
        Field.STATUS: _status(layout),
        Field.CAUSES: _causes(layout),
        Field.LENGTH: Bound(True, "the message's, classic or FD as the layout says", f"{_DROPPED} as wrong_length"),
        Field.CHECKSUM: Bound(layout.checksum, "the payload's own, beside CAN's", f"{_DROPPED} as bad_checksum")
        if layout.checksum
        else Bound(False, "CAN's own alone", "damage behind the controller is believed"),
    }


def _count(layout: HostProtocol) -> Bound:
    if layout.sequence_modulus:
        return Bound(True, "one to a command", "equal: counted as duplicate; different: both dropped")
    return Bound(False, "an answer names no command", "the newest is taken")


def _sequence(layout: HostProtocol) -> Bound:
    if layout.sequence_modulus:
        return Bound(True, f"that of a command sent, modulo {layout.sequence_modulus}", f"{_DROPPED} as stale")
    return Bound(False, _NOT_CARRIED, "an answer late by whole periods passes for a prompt one")


def _range(layout: HostProtocol) -> str:
    low, high = layout.positions[0]
    return f"{low:.3g} to {high:.3g} counts" if high > _ROUNDED else f"{low:g} to {high:g} counts"


def _stamp(layout: HostProtocol) -> Bound:
    if any(layout.stamp_wraps_ns):
        text = "between command and answer, less a learnt offset; drift of 500 ppm is followed"
        return Bound(True, text, "the sample is not used")
    return Bound(False, _NOT_CARRIED, "the instant is estimated from frames of this host's own clock")


def _status(layout: HostProtocol) -> Bound:
    if not layout.states:
        return Bound(False, _NOT_CARRIED, "a drive counts as enabled while it is told to be")
    names = ", ".join((bit.name or "").lower() for bit in DriveStatus if bit & layout.tells)
    return Bound(True, names, "invalid_value, where the field has other values")


def _causes(layout: HostProtocol) -> Bound:
    if layout.causes:
        return Bound(True, "watchdog, encoder_fault beside fault", "the drive's word is taken")
    return Bound(False, "a fault without its cause", "the fault that latches is drive_fault")
