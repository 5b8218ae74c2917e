"""What a sensor has measured, as laws and programs of users see it."""

from typing import NamedTuple


class Reading(NamedTuple):
    """The newest reading of a sensor.

    channel: its place among [sensors], 0-based. value: in the sensor's unit; NaN before the first. stamp_ns: instant of
    the sample on the sensor's own clock. sequence: 0 to 255, one more with every sample; -1 before the first. valid:
    not older than the sensor's silent_ticks, and within its range.
    """

    channel: int
    value: float
    stamp_ns: int
    sequence: int
    valid: bool
