"""Whether an axis' encoder can say every position of its travel: beyond, its count would wrap or stay at its end."""

from drivers.protocols.base import HostProtocol
from hil.rig.schema import RigConfig


def encoder_range_problems(rig: RigConfig, layout: HostProtocol) -> list[str]:
    """A line for every axis whose travel, with limits.following_error beyond either end, is more than the layout's
    position signal can carry.
    """
    problems = []
    for (name, axis), counts in zip(rig.axes.items(), layout.positions, strict=True):
        least, greatest = (count * axis.encoder_resolution for count in counts)
        beyond, unit = axis.limits.following_error, "m" if axis.kind == "linear" else "rad"
        low, high = axis.limits.position[0] - beyond, axis.limits.position[1] + beyond
        if not (least <= low and high <= greatest):
            problems.append(
                f"axes.{name}.limits.position = {axis.limits.position}: with limits.following_error = {beyond:g} "
                f"beyond either end, the position must be told from {low:g} to {high:g} {unit}; "
                f"{rig.bus.protocol} carries {least:g} to {greatest:g} {unit} ({counts[0]:.0f} to {counts[1]:.0f} "
                f"counts at encoder_resolution = {axis.encoder_resolution:g}), beyond which it wraps. Change "
                "encoder_resolution, offset or the travel"
            )
    return problems
