"""A bus of several segments, taken apart: what [bus] says, for the axes of each of them.

Axes are on the segments in the order of [axes], so that each has a run of neighbours, and what [bus] has one of per
axis is cut there. Identifiers stay what they are in the rig as a whole: no two drives share one, whatever segment they
are on, so that a cable in the wrong socket brings answers that nobody knows there.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from drivers.base.plugins import load
from drivers.config import BusConfig
from drivers.families import family_of
from drivers.protocols.base import LayoutError


class Segment(NamedTuple):
    """One segment of a rig. axes: numbers of those on it, in the rig. bus: as [bus] of a rig with these axes alone."""

    axes: range
    bus: BusConfig


def segments_of(bus: BusConfig, n_axes: int) -> list[Segment]:
    """The segments of a rig, one where [bus] says nothing of them. Raises LayoutError where they cannot be had."""
    if not bus.segments:
        return [Segment(range(n_axes), bus)]
    counts = [len(segment.axes) for segment in bus.segments]
    if sum(counts) != n_axes:
        raise LayoutError(f"bus.segments has {sum(counts)} axes; the rig has {n_axes}")
    cut = _cutter(bus, n_axes)
    found, first = [], 0
    for segment, count in zip(bus.segments, counts, strict=True):
        axes = range(first, first + count)
        changes = {"segments": [], "channel": segment.channel, **cut(axes)}
        found.append(Segment(axes, bus.model_copy(update=changes)))
        first += count
    return found


def _cutter(bus: BusConfig, n_axes: int) -> Callable[[range], dict[str, Any]]:
    """What of [bus] another segment has otherwise, under this layout."""
    family = family_of(bus.protocol)
    if family is None:
        raise LayoutError(f"bus.segments: {bus.protocol} is a layout of your own, which has all axes on one segment")
    if not family.cut:
        raise LayoutError(f"bus.segments: drives under {bus.protocol} are all on one segment")
    cut: Callable[[range], dict[str, Any]] = load(family.cut)(bus, n_axes)
    return cut


def of_axes(axes: range, values: Sequence[Any]) -> list[Any]:
    """Of a list with one entry an axis, those of the axes on a segment."""
    return list(values[axes.start : axes.stop])
