"""Frame layouts by the name a rig file gives them: bytes to values and back, no I/O."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.protocols.base import DeviceProtocol, HostProtocol, LayoutError
from drivers.protocols.mounting import MountedDevice, MountedHost, Mounting, is_straight

if TYPE_CHECKING:  # pydantic: not for those who want hil.cycle.gate alone
    from drivers.config import BusConfig

__all__ = ["LayoutError", "device_protocol", "host_protocol"]

# The modules are imported where they are needed: a rig pays only for its own layout.


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
    match bus.protocol:
        case "stage_fd":
            from drivers.protocols.stage_fd import StageFdHost

            return StageFdHost(bus, n_axes, rated_force)
        case "stage_classic":
            from drivers.protocols.stage_classic import StageClassicHost

            return StageClassicHost(bus, n_axes, rated_force)
        case "cia402":
            from drivers.protocols.canopen.host import Cia402Host

            return Cia402Host(bus, n_axes, rated_force, period_ns, base_dir)
        case "moteus":
            from drivers.protocols.moteus import MoteusHost

            return MoteusHost(bus, n_axes, rated_force, period_ns)
        case name if name.startswith("dbc:"):
            from drivers.protocols.dbc import DbcHost

            return DbcHost(bus, n_axes, rated_force, base_dir, period_ns)
    raise LayoutError(f"bus.protocol = {bus.protocol!r}: not known")


def device_protocol(
    bus: "BusConfig", n_axes: int, rated_force: Sequence[float], base_dir: Path, mountings: Sequence[Mounting] = ()
) -> DeviceProtocol:
    """The drives' side of the layout `bus.protocol`; arguments and errors as in `host_protocol`."""
    if not is_straight(mountings):
        at_drive = [force / mounting.gear for force, mounting in zip(rated_force, mountings, strict=True)]
        return MountedDevice(device_protocol(bus, n_axes, at_drive, base_dir), mountings)
    match bus.protocol:
        case "stage_fd":
            from drivers.protocols.stage_fd import StageFdDevice

            return StageFdDevice(bus, n_axes, rated_force)
        case "stage_classic":
            from drivers.protocols.stage_classic import StageClassicDevice

            return StageClassicDevice(bus, n_axes, rated_force)
        case "cia402":
            from drivers.protocols.canopen.listener import Cia402Listener

            return Cia402Listener(bus, n_axes, rated_force, base_dir)
        case "moteus":
            from drivers.protocols.moteus import MoteusListener

            return MoteusListener(bus, n_axes, rated_force)
        case name if name.startswith("dbc:"):
            from drivers.protocols.dbc_device import DbcDevice

            return DbcDevice(bus, n_axes, rated_force, base_dir)
    raise LayoutError(f"bus.protocol = {bus.protocol!r}: not known")
