"""Our own frame layouts: the two sides of each, by the names in drivers/config.py.

The modules are imported where they are needed: a rig pays only for its own layout.
"""

from drivers.config import Wiring
from drivers.protocols.base import DeviceProtocol, HostProtocol


class _Layout:
    """What all of them are made with, as those of users are (frame_layout.py)."""

    def __init__(self, wiring: Wiring) -> None:
        self.wiring = wiring


class StageFd(_Layout):
    """CAN FD, one command frame for all drives: the project's own."""

    def host(self) -> HostProtocol:
        """A new host\'s side."""
        from drivers.protocols.stage_fd import StageFdHost

        bus, n_axes, rated_force, _, _ = self.wiring
        return StageFdHost(bus, n_axes, rated_force)

    def drives(self) -> DeviceProtocol:
        """A new drives\' side."""
        from drivers.protocols.stage_fd import StageFdDevice

        bus, n_axes, rated_force, _, _ = self.wiring
        return StageFdDevice(bus, n_axes, rated_force)


class StageClassic(_Layout):
    """The same for buses without CAN FD."""

    def host(self) -> HostProtocol:
        """A new host\'s side."""
        from drivers.protocols.stage_classic import StageClassicHost

        bus, n_axes, rated_force, _, _ = self.wiring
        return StageClassicHost(bus, n_axes, rated_force)

    def drives(self) -> DeviceProtocol:
        """A new drives\' side."""
        from drivers.protocols.stage_classic import StageClassicDevice

        bus, n_axes, rated_force, _, _ = self.wiring
        return StageClassicDevice(bus, n_axes, rated_force)


class Cia402(_Layout):
    """CANopen drives by their EDS. The emulated ones are nodes of their own (sim_plant/drives/canopen_drive.py)."""

    def host(self) -> HostProtocol:
        """A new host\'s side."""
        from drivers.protocols.canopen.host import Cia402Host

        bus, n_axes, rated_force, period_ns, base_dir = self.wiring
        return Cia402Host(bus, n_axes, rated_force, period_ns, base_dir)

    def drives(self) -> DeviceProtocol:
        """A new drives\' side."""
        from drivers.protocols.canopen.listener import Cia402Listener

        bus, n_axes, rated_force, _, base_dir = self.wiring
        return Cia402Listener(bus, n_axes, rated_force, base_dir)


class Moteus(_Layout):
    """moteus controllers. The emulated ones are nodes of their own (sim_plant/drives/moteus.py)."""

    def host(self) -> HostProtocol:
        """A new host\'s side."""
        from drivers.protocols.moteus import MoteusHost

        bus, n_axes, rated_force, period_ns, _ = self.wiring
        return MoteusHost(bus, n_axes, rated_force, period_ns)

    def drives(self) -> DeviceProtocol:
        """A new drives\' side."""
        from drivers.protocols.moteus import MoteusListener

        bus, n_axes, rated_force, _, _ = self.wiring
        return MoteusListener(bus, n_axes, rated_force)


class Dbc(_Layout):
    """Whatever a DBC file describes, as [bus.dbc] binds it."""

    def host(self) -> HostProtocol:
        """A new host\'s side."""
        from drivers.protocols.dbc import DbcHost

        bus, n_axes, rated_force, period_ns, base_dir = self.wiring
        return DbcHost(bus, n_axes, rated_force, base_dir, period_ns)

    def drives(self) -> DeviceProtocol:
        """A new drives\' side."""
        from drivers.protocols.dbc_device import DbcDevice

        bus, n_axes, rated_force, _, base_dir = self.wiring
        return DbcDevice(bus, n_axes, rated_force, base_dir)
