"""What a drive can find of its axis when it is asked to.

A layout offers one `Finder` an axis, as `index_finders`, and one `Homer`, as `drive_homers`, or a text that says why a
drive cannot. A layout whose drives count from the index by themselves and then say HOMED offers no finder. Both keep
state and read no clock: what they say and hear goes with the frames of the layout.
"""

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple, Protocol

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
    ERROR = 6  # it says that it failed


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
    offered, mounting = _of_axis(layout, axis, "index_finders")
    return offered or "" if offered is None or isinstance(offered, str) else AxisFinder(offered, mounting)


class HomingTerms(NamedTuple):
    """What a drive homes by itself with. method: the drive's number of it. speed, latch_speed: of the search and of the
    last approach, counts/s. acceleration: counts/s^2. force: greatest, N (N m).
    """

    method: int
    speed: float
    latch_speed: float
    acceleration: float
    force: float


class Homer(Protocol):
    """Of one axis whose drive homes by itself. While `search` is RUNNING the drive moves the axis, and no torque of the
    host acts; FOUND: it counts from where it has homed, and applies the host's torque again. methods: that it can be
    told. lets_go: between the host's torque and its own it applies none.
    """

    methods: Sequence[int]
    lets_go: bool

    @property
    def search(self) -> Search:
        """How far it is."""

    def begin(self, terms: HomingTerms) -> None:
        """The axis rests under the host's torque, and goes on so until `search` is RUNNING."""

    def end(self) -> None:
        """Whatever the drive does, it is to apply the host's torque again before it is next enabled."""


class AxisHomer:
    """A Homer in the terms of the axis, for a drive mounted on it so."""

    def __init__(self, homer: Homer, mounting: Mounting) -> None:
        self.homer, self._mounting = homer, mounting

    def begin(self, terms: HomingTerms) -> None:
        """terms: at the axis."""
        self.homer.begin(terms._replace(force=abs(self._mounting.force_at_drive(terms.force))))


def drive_homer(layout: HostProtocol, axis: int) -> AxisHomer | str:
    """What lets the drive of an axis home by itself; or why it cannot."""
    offered, mounting = _of_axis(layout, axis, "drive_homers")
    if offered is None:
        return f"no drive can be told to home over bus.protocol = {layout.name!r}"
    return offered if isinstance(offered, str) else AxisHomer(offered, mounting)


def _of_axis(layout: HostProtocol, axis: int, offers: str) -> tuple[Any, Mounting]:
    """What a layout has of an axis under that name, None where it has nothing; and how its drive is mounted."""
    unmounted, number = getattr(layout, "layout", layout), axis
    mountings: Sequence[Mounting] = getattr(layout, "mountings", ())
    mounting = mountings[axis] if mountings else STRAIGHT
    for part in getattr(unmounted, "segments", (unmounted,)):
        if number < part.n_axes:
            offered = getattr(part, offers, ())
            return (offered[number] if offered else None), mounting
        number -= part.n_axes
    return None, mounting
