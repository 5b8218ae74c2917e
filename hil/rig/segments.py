"""A rig on several CAN segments as rigs on one: for what is done on one bus at a time (bring-up, `hil bus`)."""

from drivers.protocols.base import LayoutError
from drivers.protocols.segments import segments_of
from hil.rig.schema import RigConfig, RigError


def segment_rigs(rig: RigConfig) -> list[RigConfig]:
    """For each segment the rig with the axes on it and no others; the rig itself where it has one segment.

    They are for talking to the drives: task, plant and lists by axis stay those of the whole rig. Raises RigError where
    the rig's layout cannot be on several segments.
    """
    if not rig.bus.segments:
        return [rig]
    try:
        parts = segments_of(rig.bus, len(rig.axes))
    except LayoutError as error:
        raise RigError([str(error)]) from None
    names = rig.axis_names
    return [
        rig.model_copy(update={"bus": bus, "axes": {names[axis]: rig.axes[names[axis]] for axis in axes}})
        for axes, bus in parts
    ]


def rig_on(rig: RigConfig, channel: str) -> RigConfig:
    """That of `segment_rigs` on a channel; the rig itself where it has one segment. Raises RigError."""
    parts = segment_rigs(rig)
    if len(parts) == 1:
        return rig
    for part in parts:
        if part.bus.channel == channel:
            return part
    raise RigError([f"bus.segments: the rig is on {', '.join(rig.bus.channels)}, not on {channel}; see --channel"])
