"""Frame layouts by the name a rig file gives them: bytes to values and back, no I/O.

Our own stand with their family (drivers/families). Their modules are imported where it is needed: a rig pays for its
own layout alone.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from drivers.base.plugins import load
from drivers.families import Sides, sides_of
from drivers.protocols.base import MOST_SENT, DeviceProtocol, HostProtocol, Layout, LayoutError
from drivers.protocols.mounting import MountedDevice, MountedHost, Mounting, is_straight

if TYPE_CHECKING:  # pydantic: not for those who want hil.cycle.gate alone
    from drivers.config import BusConfig, Wiring
    from drivers.protocols.segments import Segment

__all__ = ["LayoutError", "device_protocol", "host_protocol"]


def host_protocol(
    bus: "BusConfig",
    n_axes: int,
    rated_force: Sequence[float],
    base_dir: Path,
    period_ns: int = 1_000_000,
    mountings: Sequence[Mounting] = (),
) -> HostProtocol:
    """The host's side of the layout `bus.protocol`, before any bus is opened.

    rated_force: N or N m per axis, at the axis. base_dir: folder of the rig file, where relative paths start.
    period_ns: of the control loop; some drives are told it, and layouts without time stamps count with it. mountings:
    of the drives on their axes; none: all straight.
    Raises LayoutError (a ValueError) where the rig cannot be carried by the layout.
    """
    if not is_straight(mountings):
        at_drive = [force / mounting.gear for force, mounting in zip(rated_force, mountings, strict=True)]
        return MountedHost(host_protocol(bus, n_axes, at_drive, base_dir, period_ns), mountings)
    if bus.segments:
        from drivers.protocols.segmented import SegmentedHost, on_each

        def make(segment: "Segment") -> HostProtocol:
            axes, part = segment
            return host_protocol(part, len(axes), rated_force[axes.start : axes.stop], base_dir, period_ns)

        return _of_bounded_length(SegmentedHost(on_each(bus, n_axes, make)), period_ns)
    return _of_bounded_length(_layout(bus, n_axes, rated_force, period_ns, base_dir).host(), period_ns)


def _of_bounded_length(host: HostProtocol, period_ns: int) -> HostProtocol:
    """A layout that never sends more in a tick than is kept of it. Raises LayoutError for another."""
    sent = sum(message.sender == "host" for message in host.messages(period_ns))
    if sent > MOST_SENT:
        raise LayoutError(f"up to {sent} frames to the drives in one tick; there is room for {MOST_SENT}")
    return host


def device_protocol(
    bus: "BusConfig", n_axes: int, rated_force: Sequence[float], base_dir: Path, mountings: Sequence[Mounting] = ()
) -> DeviceProtocol:
    """The drives' side of the layout `bus.protocol`; arguments and errors as in `host_protocol`."""
    if not is_straight(mountings):
        at_drive = [force / mounting.gear for force, mounting in zip(rated_force, mountings, strict=True)]
        return MountedDevice(device_protocol(bus, n_axes, at_drive, base_dir), mountings)
    if bus.segments:
        from drivers.protocols.segmented import SegmentedDevice, on_each

        def make(segment: "Segment") -> DeviceProtocol:
            axes, part = segment
            return device_protocol(part, len(axes), rated_force[axes.start : axes.stop], base_dir)

        return SegmentedDevice(on_each(bus, n_axes, make))
    return _layout(bus, n_axes, rated_force, 1_000_000, base_dir).drives()


def _layout(bus: "BusConfig", n_axes: int, rated_force: Sequence[float], period_ns: int, base_dir: Path) -> Layout:
    from drivers.config import Wiring

    wiring = Wiring(bus, n_axes, rated_force, period_ns, base_dir)
    if sides := sides_of(bus.protocol):
        return _Own(wiring, sides)
    from drivers.protocols.user_layout import UserLayout

    return UserLayout(wiring)


class _Own(NamedTuple):
    """One of the layouts of our families."""

    wiring: "Wiring"
    sides: Sides

    def host(self) -> HostProtocol:
        """A new host's side."""
        made: HostProtocol = load(self.sides.host)(self.wiring)
        return made

    def drives(self) -> DeviceProtocol:
        """A new drives' side."""
        made: DeviceProtocol = load(self.sides.drives)(self.wiring)
        return made
