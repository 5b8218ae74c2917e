"""The canopen package as a master, and our drives beside it, in a thread of this process."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import canopen
from canopen.profiles.p402 import BaseNode402

from drivers.bus.any_bus import AnyPort, joined
from drivers.config import BusConfig
from sim_plant.config import EmulatedDriveConfig
from sim_plant.drive_double import DoubleSettings, DriveDouble, make_drive

NODE = 3
PATIENCE_S = 100.0  # only a failing test waits this long; a process in a guest may take over 30 s to start
# Without those that the package waits out in any case (reset of a fault), or after which it tries again (one state).
_PATIENT = (
    "TIMEOUT_SWITCH_OP_MODE",
    "TIMEOUT_SWITCH_STATE_FINAL",
    "TIMEOUT_CHECK_TPDO",
    "TIMEOUT_HOMING_DEFAULT",
)


def master_of(network: canopen.Network, eds: Path, *, profile: bool = True) -> Any:
    """A fresh master's view of the drive NODE, which has just reset its communication. profile: with CiA 402's."""
    made = patient(BaseNode402(NODE, str(eds)) if profile else canopen.RemoteNode(NODE, str(eds)))
    network.add_node(made)
    made.nmt.state = "RESET COMMUNICATION"
    assert made.sdo[0x1001].raw == 0  # frames keep their order: its boot-up message came before this answer
    return made


def patient(node: Any) -> Any:
    """The same node with time-outs that a loaded computer keeps."""
    node.sdo.RESPONSE_TIMEOUT = PATIENCE_S
    for name in _PATIENT:
        if hasattr(node, name):
            setattr(node, name, PATIENCE_S)
    return node


def eventually(holds: Callable[[], bool]) -> None:
    """Wait until it does."""
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.002)


class Bench:
    """double: our drive, node NODE; its orders. network: canopen's. said: what the drive told. sync_s: of a SYNC."""

    def __init__(
        self, double: DriveDouble, network: canopen.Network, eds: Path, said: list[str], sync_s: float
    ) -> None:
        self.double = double
        self.network = network
        self.said = said
        self.sync_s = sync_s
        self._eds = eds

    def node(self, *, profile: bool = True) -> Any:
        """See master_of."""
        return master_of(self.network, self._eds, profile=profile)

    def operational(self) -> Any:
        """A master of CiA 402 whose drive exchanges PDOs."""
        node = self.node()
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"
        return node


@contextmanager
def foreign_master(
    eds: Path, interface: str = "local", channel: str = "can0", sync_s: float = 0.005, **quirks: Any
) -> Iterator[Bench]:
    """A drive by an EDS, with quirks as of [plant.drive], and a master; interface, channel: of python-can.

    sync_s: the kernel keeps sending SYNC, however late this process is: shorter than all that follows from one, and
    what is left to do grows without end.
    """
    settings = DoubleSettings(2.0, 4096, 1e-4, 1e-3, 0.0, 0.0, EmulatedDriveConfig(kind="cia402", **quirks))
    bus = BusConfig(protocol="cia402", interface=interface, channel=channel)
    said: list[str] = []
    ending = threading.Event()

    def serve(double: DriveDouble, port: AnyPort) -> None:
        while not ending.is_set():
            first = port.wait(0.002)
            now_ns = time.monotonic_ns()
            double.step(([first] if first else []) + port.drain(now_ns), now_ns)

    with joined(bus, fd=False) as port:
        double = DriveDouble([make_drive(eds, NODE, settings, time.monotonic_ns())], port, said.append, every=False)
        thread = threading.Thread(target=serve, args=(double, port))
        thread.start()
        network = canopen.Network()
        network.NOTIFIER_CYCLE = 0.02
        network.connect(interface=interface, channel=channel)
        try:
            yield Bench(double, network, eds, said, sync_s)
        finally:
            network.sync.stop()
            network.disconnect()
            ending.set()
            thread.join()
