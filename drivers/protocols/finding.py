"""What a drive can find of its axis when it is asked to: a layout offers one `Finder` an axis, as `index_finders`.

A layout whose drives count from the index by themselves and then say HOMED offers none. Finders keep state and read no
clock: what they say and hear goes with the frames of the layout.
"""

from collections.abc import Sequence
from enum import IntEnum
from typing import Protocol

from drivers.protocols.base import HostProtocol
from drivers.protocols.mounting import STRAIGHT, Mounting


class Search(IntEnum):
    """How far a drive is with what it was asked."""

    NONE = 0  # nothing was asked
    ASKED = 1  # it has yet to answer: the axis waits
    RUNNING = 2  # it looks out; the axis moves
    FOUND = 3
    MISSED = 4  # asked at rest: it has seen nothing
    FAILED = 5  # it refused, or did not answer


class Finder(Protocol):
    """Of one axis. count: the drive's count at what it has found."""

    count: int

    @property
    def search(self) -> Search:
        """How far it is."""

    def begin(self) -> None:
        """Look out from now on; what was found before counts no more. The axis rests until `search` is RUNNING."""

    def settle(self) -> None:
        """The axis rests at the end of its way: FOUND or MISSED follows."""

    def end(self) -> None:
        """Look out no longer."""


class AxisFinder:
    """A Finder in the terms of the axis, for a drive mounted on it so."""

    def __init__(self, finder: Finder, mounting: Mounting) -> None:
        self.finder, self._mounting = finder, mounting

    @property
    def count(self) -> int:
        """The axis' count at what has been found."""
        return self._mounting.count_at_axis(self.finder.count)


def index_finder(layout: HostProtocol, axis: int) -> AxisFinder | str:
    """What finds the encoder's index of an axis; or why its drive cannot, empty where the layout has no such thing."""
    unmounted, number = getattr(layout, "layout", layout), axis
    for part in getattr(unmounted, "segments", (unmounted,)):
        if number < part.n_axes:
            offered: Sequence[Finder | str] = getattr(part, "index_finders", ())
            found = offered[number] if offered else ""
            if isinstance(found, str):
                return found
            mountings: Sequence[Mounting] = getattr(layout, "mountings", ())
            return AxisFinder(found, mountings[axis] if mountings else STRAIGHT)
        number -= part.n_axes
    return ""
