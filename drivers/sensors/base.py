"""What every kind of sensor frame offers: bytes to a measurement, no I/O, no clock."""

from collections.abc import Sequence
from typing import NamedTuple

from drivers.protocols.base import Message


class Measurement(NamedTuple):
    """One frame of a sensor.

    value: in the sensor's unit. sequence: the sensor counts its samples with it, modulo 256. stamp_ns: of the sensor's
    own clock, unwrapped to the value nearest the frame's reception. valid: what the sensor says of this value.
    """

    value: float
    sequence: int
    stamp_ns: int
    valid: bool


def trigger_of(messages: Sequence[Message], echo_id: int | None, period_ns: int) -> Message | None:
    """The host's frame at whose end sensors sample: the one that the drives sample at; None where none is sent in
    every tick.
    """
    cyclic = [message for message in messages if message.sender == "host" and message.period_ns <= period_ns]
    named = [message for message in cyclic if message.can_id == echo_id]
    found = named or cyclic
    return found[-1] if found else None
