"""Frame layouts by the name a rig file gives them: bytes to values and back, no I/O.

Below are the two sides of each of ours, under the names of LAYOUTS (drivers/config.py). Their modules are imported
where they are needed: a rig pays only for its own layout.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.protocols.base import MOST_SENT, DeviceProtocol, HostProtocol, LayoutError
from drivers.protocols.mounting import MountedDevice, MountedHost, Mounting, is_straight

if TYPE_CHECKING:  # pydantic: not for those who want hil.cycle.gate alone
    from drivers.config import BusConfig, Wiring
    from drivers.protocols.frame_layout import FrameLayout
    from drivers.segments import Segment

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
    period_ns: of the control loop; cia402 tells its drives, and layouts without time stamps count with it. mountings:
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


def _layout(
    bus: "BusConfig", n_axes: int, rated_force: Sequence[float], period_ns: int, base_dir: Path
) -> "FrameLayout":
    from drivers import plugins
    from drivers.config import LAYOUT_KIND, Wiring

    wiring = Wiring(bus, n_axes, rated_force, period_ns, base_dir)
    if ours := LAYOUT_KIND.own(bus.protocol):
        made: FrameLayout = plugins.load(ours)(wiring)
        return made
    from drivers.protocols.user_layout import UserLayout

    return UserLayout(wiring)


class _Layout:
    """What all of them are made with, as those of users are (frame_layout.py)."""

    def __init__(self, wiring: "Wiring") -> None:
        self.wiring = wiring


class StageFd(_Layout):
    """CAN FD, one command frame for all drives: the project's own."""

    def host(self) -> HostProtocol:
        """A new host's side."""
        from drivers.protocols.stage_fd import StageFdHost

        bus, n_axes, rated_force, _, _ = self.wiring
        return StageFdHost(bus, n_axes, rated_force)

    def drives(self) -> DeviceProtocol:
        """A new drives' side."""
        from drivers.protocols.stage_fd import StageFdDevice

        bus, n_axes, rated_force, _, _ = self.wiring
        return StageFdDevice(bus, n_axes, rated_force)


class StageClassic(_Layout):
    """The same for buses without CAN FD."""

    def host(self) -> HostProtocol:
        """A new host's side."""
        from drivers.protocols.stage_classic import StageClassicHost

        bus, n_axes, rated_force, _, _ = self.wiring
        return StageClassicHost(bus, n_axes, rated_force)

    def drives(self) -> DeviceProtocol:
        """A new drives' side."""
        from drivers.protocols.stage_classic import StageClassicDevice

        bus, n_axes, rated_force, _, _ = self.wiring
        return StageClassicDevice(bus, n_axes, rated_force)


class Cia402(_Layout):
    """CANopen drives by their EDS. The emulated ones are nodes of their own (sim_plant/drives/canopen_drive.py)."""

    def host(self) -> HostProtocol:
        """A new host's side."""
        from drivers.protocols.canopen.host import Cia402Host

        bus, n_axes, rated_force, period_ns, base_dir = self.wiring
        return Cia402Host(bus, n_axes, rated_force, period_ns, base_dir)

    def drives(self) -> DeviceProtocol:
        """A new drives' side."""
        from drivers.protocols.canopen.listener import Cia402Listener

        bus, n_axes, rated_force, _, base_dir = self.wiring
        return Cia402Listener(bus, n_axes, rated_force, base_dir)


class Moteus(_Layout):
    """moteus controllers. The emulated ones are nodes of their own (sim_plant/drives/moteus.py)."""

    def host(self) -> HostProtocol:
        """A new host's side."""
        from drivers.protocols.moteus import MoteusHost

        bus, n_axes, rated_force, period_ns, _ = self.wiring
        return MoteusHost(bus, n_axes, rated_force, period_ns)

    def drives(self) -> DeviceProtocol:
        """A new drives' side."""
        from drivers.protocols.moteus import MoteusListener

        bus, n_axes, rated_force, _, _ = self.wiring
        return MoteusListener(bus, n_axes, rated_force)


class Dbc(_Layout):
    """Whatever a DBC file describes, as [bus.dbc] binds it."""

    def host(self) -> HostProtocol:
        """A new host's side."""
        from drivers.protocols.dbc import DbcHost

        bus, n_axes, rated_force, period_ns, base_dir = self.wiring
        return DbcHost(bus, n_axes, rated_force, base_dir, period_ns)

    def drives(self) -> DeviceProtocol:
        """A new drives' side."""
        from drivers.protocols.dbc_device import DbcDevice

        bus, n_axes, rated_force, _, base_dir = self.wiring
        return DbcDevice(bus, n_axes, rated_force, base_dir)
