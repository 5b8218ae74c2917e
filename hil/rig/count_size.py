"""Whether encoder_resolution and gear of an axis go with its drive's count, where the layout knows how far that is.

Power goes through a gear: what an axis moves by a count, times the force there, is what the drive moves by it, times
the drive's torque, less friction. So gear = efficiency * count / encoder_resolution, and one of the three that is wrong
shows before anything moves.
"""

from typing import Final

from drivers.protocols.base import HostProtocol
from drivers.protocols.count_size import CountSize, count_sizes
from hil.rig.schema import RigConfig
from hil.rig.tables import AxisConfig

_ROUNDED: Final = 0.02  # by which stated values may differ from true ones
_LEAST_EFFICIENCY: Final = 0.2  # of a gear: screws that hold themselves have less than half


def size_problems(rig: RigConfig, layout: HostProtocol) -> list[str]:
    """A line for every axis whose drive counts otherwise than the axis says."""
    axes = zip(rig.axes.items(), count_sizes(layout), strict=True)
    return [text for (name, axis), count in axes if count is not None and (text := _problem(name, axis, count))]


def _problem(name: str, axis: AxisConfig, count: CountSize) -> str:
    """Empty where all is well."""
    if not count.shaft and count.angle == (axis.kind == "rotary") and _is_near(axis.encoder_resolution / count.size):
        return ""  # of an encoder on the axis
    ideal = count.size / axis.encoder_resolution
    least = 1.0 - _ROUNDED if axis.gear == 1.0 else _LEAST_EFFICIENCY
    if least <= axis.gear / ideal <= 1.0 + _ROUNDED:
        return ""
    unit, of_axis = "rad" if count.angle else "m", "rad" if axis.kind == "rotary" else "m"
    if axis.gear == 1.0:
        expected = f"with gear = 1 encoder_resolution has to be {count.size:.6g} {of_axis}"
    else:
        expected = f"gear has to be {ideal:.6g}, or less by friction (at least {least * ideal:.4g})"
    return (
        f"axes.{name}: encoder_resolution = {axis.encoder_resolution:g} {of_axis}, gear = {axis.gear:g}: a count of "
        f"the drive is {count.size:.6g} {unit} ({count.source}), so {expected}"
    )


def _is_near(ratio: float) -> bool:
    return abs(ratio - 1.0) <= _ROUNDED
