"""What every kind of sensor frame offers: bytes to a measurement, no I/O, no clock."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from drivers.frame import Frame
from drivers.protocols.base import Message, Reject


class Measured(NamedTuple):
    """One frame of a sensor.

    value: in the sensor's unit. sequence: the sensor counts its samples with it, modulo 256; -1: it does not, and the
    host counts its frames. stamp_ns: of the sensor's own clock, unwrapped to the value nearest the frame's reception;
    None: it has none, and the frame's reception counts. valid: what the sensor says of this value.
    """

    value: float
    sequence: int = -1
    stamp_ns: int | None = None
    valid: bool = True


class SensorReader(Protocol):
    """One sensor's frames, as the host reads them.

    can_ids: what it sends, its readings first. problem: why it is no good, for people; empty where all is well.
    """

    @property
    def can_ids(self) -> Sequence[int]:
        """See above."""

    @property
    def problem(self) -> str:
        """See above."""

    def decode(self, frame: Frame) -> Measured | Reject:
        """The measurement in a frame of these identifiers. Never raises, whatever the bytes."""

    def service(self) -> Frame | None:
        """Asked once a tick: a frame that configures or starts the sensor; None: nothing is due."""


def trigger_of(messages: Sequence[Message], echo_id: int | None, period_ns: int) -> Message | None:
    """The host's frame at whose end sensors sample: the one that the drives sample at; None where none is sent in
    every tick.
    """
    cyclic = [message for message in messages if message.sender == "host" and message.period_ns <= period_ns]
    named = [message for message in cyclic if message.can_id == echo_id]
    found = named or cyclic
    return found[-1] if found else None
