"""[bus.dbc] of one segment of several."""

from collections.abc import Callable
from typing import Any

from drivers.config import BusConfig
from drivers.families.dbc.config import DbcBinding, VescBinding, dbc_keys
from drivers.protocols.base import LayoutError
from drivers.protocols.segments import of_axes

PER_AXIS = ("position", "status", "error", "torque", "enable", "reset", "start", "stop", "feedback_counter")
_BY_MESSAGE = ("constant", "on_change", "periodic", "remote", "command_counter", "checksum")


def cut(bus: BusConfig, n_axes: int) -> Callable[[range], dict[str, Any]]:
    """Lists of one entry an axis are cut; of the others every segment has what concerns its own messages, or nobody's.

    Raises LayoutError for one signal or frame that is for all axes, and for a message with signals of several segments.
    """
    binding = dbc_keys(bus).dbc
    if binding is None:
        raise LayoutError(f"bus.protocol = {bus.protocol!r} needs a table [bus.dbc] that binds its signals")
    for name in PER_AXIS:
        count = len(getattr(binding, name))
        if count not in (0, n_axes):
            raise LayoutError(
                f"bus.dbc.{name} has {count} entries; with bus.segments one per axis, {n_axes}, are needed"
            )
    _refuse_shared_messages(bus, binding)
    everybody = {item.message for name in PER_AXIS for item in getattr(binding, name)}

    def of_segment(axes: range) -> dict[str, Any]:
        lists: dict[str, Any] = {name: of_axes(axes, getattr(binding, name)) for name in PER_AXIS}
        theirs = everybody - {item.message for items in lists.values() for item in items}
        for name in _BY_MESSAGE:
            lists[name] = [item for item in getattr(binding, name) if _message(item) not in theirs]
        asked = [item for item in binding.read_back if item.axis in axes]
        lists["read_back"] = [item.model_copy(update={"axis": item.axis - axes.start}) for item in asked]
        inputs = [item for item in binding.inputs if item.axis in axes]
        if binding.vesc:
            lists["vesc"] = _vesc_of(axes, binding.vesc)
        lists["inputs"] = [item.model_copy(update={"axis": item.axis - axes.start}) for item in inputs]
        return {"dbc": binding.model_copy(update=lists)}

    return of_segment


def _vesc_of(axes: range, vesc: VescBinding) -> VescBinding:
    """The values that concern these axes' drives, by the segment's own axes; IDs are free on every segment."""
    values = [
        item if item.axis is None else item.model_copy(update={"axis": item.axis - axes.start})
        for item in vesc.values
        if item.axis is None or item.axis in axes
    ]
    return vesc.model_copy(update={"values": values})


def _message(item: Any) -> str:
    """Name of the message that an entry is about; a page of it (MESSAGE.SIGNAL) is about it, too."""
    name: str = item if isinstance(item, str) else item.message
    return name.partition(".")[0]


def _refuse_shared_messages(bus: BusConfig, binding: DbcBinding) -> None:
    """A message has its signals from, or for, drives of one segment."""
    seen: dict[str, str] = {}
    first = 0
    for segment in bus.segments:
        axes = range(first, first + len(segment.axes))
        first = axes.stop
        for item in [item for name in PER_AXIS for item in of_axes(axes, getattr(binding, name))]:
            if seen.setdefault(item.message, segment.channel) != segment.channel:
                places = f"{seen[item.message]} and on {segment.channel}"
                raise LayoutError(f"bus.segments: message {item.message} has signals of axes on {places}")
