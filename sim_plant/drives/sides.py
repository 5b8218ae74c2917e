"""The drives' side of a layout whose drives are no nodes of their own (installed.py has those)."""

from collections.abc import Sequence
from pathlib import Path

from drivers.config import BusConfig
from drivers.families.stage.config import stage_keys
from drivers.protocols import device_protocol
from drivers.protocols.base import DeviceProtocol, LayoutError
from drivers.protocols.segmented import SegmentedDevice, on_each
from drivers.protocols.segments import Segment
from sim_plant.drives.stage import AXES, MADE


def drives_side(bus: BusConfig, n_axes: int, rated_force: Sequence[float], base_dir: Path) -> DeviceProtocol:
    """Ours where we have drives of our own (stage.py), else the layout's. rated_force: N per axis, at the drive.
    base_dir: of the rig file. Raises LayoutError (a ValueError) for a rig that the layout cannot have.
    """
    if bus.protocol not in MADE:
        return device_protocol(bus, n_axes, rated_force, base_dir)
    if not bus.segments:
        return _stage(bus, rated_force)
    return SegmentedDevice(on_each(bus, n_axes, lambda part: _of_segment(part, rated_force)))


def _of_segment(segment: Segment, rated_force: Sequence[float]) -> DeviceProtocol:
    return _stage(segment.bus, rated_force[segment.axes.start : segment.axes.stop])


def _stage(bus: BusConfig, rated_force: Sequence[float]) -> DeviceProtocol:
    keys, count = stage_keys(bus), len(rated_force)
    if not 1 <= count <= AXES:
        raise LayoutError(f"{count} axes: the stage layouts carry 1 to {AXES}")
    made: DeviceProtocol = MADE[bus.protocol](keys.host_id, keys.feedback_id, rated_force)
    return made
