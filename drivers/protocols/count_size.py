"""How far a count of a drive is, where the layout knows: what encoder_resolution and gear are compared with."""

from collections.abc import Sequence
from typing import NamedTuple

from drivers.protocols.base import HostProtocol


class CountSize(NamedTuple):
    """One count of a drive's position. size: in m, or in rad where `angle`. shaft: it is surely of the shaft (slider)
    whose torque (force) the drive takes; else it may be of an encoder on the axis itself. source: why, for people.
    """

    size: float
    angle: bool
    shaft: bool
    source: str


def count_sizes(layout: HostProtocol) -> Sequence[CountSize | None]:
    """By axis; None where the layout does not know. A layout that knows has them as `count_sizes`."""
    unmounted = getattr(layout, "layout", layout)
    found: list[CountSize | None] = []
    for part in getattr(unmounted, "segments", (unmounted,)):
        found += getattr(part, "count_sizes", None) or [None] * part.n_axes
    return found
