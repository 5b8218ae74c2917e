"""Frame layouts by the name a rig file gives them: bytes to values and back, no I/O."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from drivers.protocols.base import DeviceProtocol, HostProtocol, LayoutError
from drivers.protocols.mounting import MountedDevice, MountedHost, Mounting, is_straight

if TYPE_CHECKING:  # pydantic: not for those who want hil.cycle.gate alone
    from drivers.config import BusConfig

__all__ = ["LayoutError", "device_protocol", "host_protocol"]


class FrameLayout(Protocol):
    """A frame layout, ours or a user's."""

    def host(self) -> HostProtocol:
        """A new host's side."""

    def drives(self) -> DeviceProtocol:
        """A new drives' side."""


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
    period_ns: of the control loop; cia402 tells its drives, and layouts without time stamps count with it. mountings:
    of the drives on their axes; none: all straight.
    Raises LayoutError (a ValueError) where the rig cannot be carried by the layout.
    """
    if not is_straight(mountings):
        at_drive = [force / mounting.gear for force, mounting in zip(rated_force, mountings, strict=True)]
        return MountedHost(host_protocol(bus, n_axes, at_drive, base_dir, period_ns), mountings)
    return _layout(bus, n_axes, rated_force, period_ns, base_dir).host()


def device_protocol(
    bus: "BusConfig", n_axes: int, rated_force: Sequence[float], base_dir: Path, mountings: Sequence[Mounting] = ()
) -> DeviceProtocol:
    """The drives' side of the layout `bus.protocol`; arguments and errors as in `host_protocol`."""
    if not is_straight(mountings):
        at_drive = [force / mounting.gear for force, mounting in zip(rated_force, mountings, strict=True)]
        return MountedDevice(device_protocol(bus, n_axes, at_drive, base_dir), mountings)
    return _layout(bus, n_axes, rated_force, 1_000_000, base_dir).drives()


def _layout(bus: "BusConfig", n_axes: int, rated_force: Sequence[float], period_ns: int, base_dir: Path) -> FrameLayout:
    from drivers import plugins
    from drivers.config import LAYOUT_KIND, Wiring

    wiring = Wiring(bus, n_axes, rated_force, period_ns, base_dir)
    if ours := LAYOUT_KIND.own(bus.protocol):
        made: FrameLayout = plugins.load(ours)(wiring)
        return made
    from drivers.protocols.user_layout import UserLayout

    return UserLayout(wiring)
