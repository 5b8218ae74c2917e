"""A bus of several segments, taken apart: what [bus] says, for the axes of each of them.

Axes are on the segments in the order of [axes], so that each has a run of neighbours, and what [bus] has one of per
axis is cut there. Identifiers stay what they are in the rig as a whole: no two drives share one, whatever segment they
are on, so that a cable in the wrong socket brings answers that nobody knows there.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from drivers.config import LAYOUT_KIND, BusConfig, DbcBinding
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
    _refuse_shared_messages(found)
    return found


def _cutter(bus: BusConfig, n_axes: int) -> Callable[[range], dict[str, Any]]:
    """What of [bus] another segment has otherwise, under this layout."""
    if bus.dbc is not None:
        return _dbc_cutter(bus.dbc, n_axes)
    if bus.protocol == "cia402":
        from drivers.protocols.canopen.host import node_ids

        nodes = node_ids(bus, n_axes)
        if bus.cia402 is None:  # the project's own drive, which is not told its number there
            return lambda axes: {"node_id": nodes[axes[0]]}
        cia402 = bus.cia402
        return lambda axes: {
            "cia402": cia402.model_copy(
                update={
                    "nodes": _of(axes, nodes),
                    "eds": _of(axes, cia402.eds) if len(cia402.eds) == n_axes else cia402.eds,
                    "rated_torque": _of(axes, cia402.rated_torque),
                }
            )
        }
    if bus.protocol == "moteus":
        from drivers.config import MoteusConfig
        from drivers.protocols.moteus import moteus_nodes

        moteus, numbers = bus.moteus or MoteusConfig(), moteus_nodes(bus, n_axes)
        return lambda axes: {"moteus": moteus.model_copy(update={"nodes": _of(axes, numbers)})}
    if LAYOUT_KIND.own(bus.protocol):
        return lambda axes: {"feedback_id": bus.feedback_id + axes[0]}
    raise LayoutError(f"bus.segments: {bus.protocol} is a layout of your own, which has all axes on one segment")


def _of(axes: range, values: Sequence[Any]) -> list[Any]:
    return list(values[axes.start : axes.stop])


PER_AXIS = ("position", "status", "error", "torque", "enable", "reset", "start", "stop", "feedback_counter")
_BY_MESSAGE = ("constant", "on_change", "periodic", "remote", "command_counter", "checksum")


def _dbc_cutter(binding: DbcBinding, n_axes: int) -> Callable[[range], dict[str, Any]]:
    """Lists of one entry an axis are cut; of the others every segment has what concerns its own messages, or nobody's.

    Raises LayoutError for one signal or frame that is for all axes.
    """
    for name in PER_AXIS:
        count = len(getattr(binding, name))
        if count not in (0, n_axes):
            raise LayoutError(
                f"bus.dbc.{name} has {count} entries; with bus.segments one per axis, {n_axes}, are needed"
            )
    everybody = {item.message for name in PER_AXIS for item in getattr(binding, name)}

    def cut(axes: range) -> dict[str, Any]:
        lists = {name: _of(axes, getattr(binding, name)) for name in PER_AXIS}
        theirs = everybody - {item.message for items in lists.values() for item in items}
        for name in _BY_MESSAGE:
            lists[name] = [item for item in getattr(binding, name) if _message(item) not in theirs]
        return {"dbc": binding.model_copy(update=lists)}

    return cut


def _message(item: Any) -> str:
    """Name of the message that an entry is about; a page of it (MESSAGE.SIGNAL) is about it, too."""
    name: str = item if isinstance(item, str) else item.message
    return name.partition(".")[0]


def _refuse_shared_messages(segments: Sequence[Segment]) -> None:
    """A message has its signals from, or for, drives of one segment."""
    seen: dict[str, str] = {}
    for _, bus in segments:
        if bus.dbc is None:
            return
        for item in [item for name in PER_AXIS for item in getattr(bus.dbc, name)]:
            if seen.setdefault(item.message, bus.channel) != bus.channel:
                places = f"{seen[item.message]} and on {bus.channel}"
                raise LayoutError(f"bus.segments: message {item.message} has signals of axes on {places}")
