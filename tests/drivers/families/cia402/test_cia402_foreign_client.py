"""A client that is not ours, the canopen package's BaseNode402, proves the emulated drive on our local bus.

The drive runs in a thread behind a python-can bus, as any node would; the client knows only its EDS file.
"""

import threading
import time
from collections.abc import Iterator

import can
import canopen
import pytest
from canopen.profiles.p402 import BaseNode402

from drivers.families.cia402 import cia301
from drivers.frame import Frame
from sim_plant.drives.canopen_drive import Cia402Drive
from sim_plant.drives.servo import ServoDrive
from tests.support.foreign_master import PATIENCE_S, patient

NODE = 5
COUNTS = 12_345


class LiveDrive(threading.Thread):
    """An emulated drive on the local bus. Its watchdog is generous: this client gives no real-time promise."""

    def __init__(self, bus: can.BusABC) -> None:
        super().__init__(daemon=True)
        self._bus = bus
        self._ending = threading.Event()
        self.servo = ServoDrive(0, 5.0, 1e-7, 60_000_000_000, True, 0)
        self.node = Cia402Drive(NODE, self.servo, lambda: COUNTS * 1e-7, time.monotonic_ns())

    def run(self) -> None:
        while not self._ending.is_set():
            message = self._bus.recv(0.01)
            now = time.monotonic_ns()
            frames = self.node.advance(now)
            if message is not None and not message.is_error_frame:
                frames += self.node.on_frame(Frame(message.arbitration_id, bytes(message.data), 0, now))
            for frame in frames:
                self._bus.send(can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))

    def end(self) -> None:
        self._ending.set()
        self.join(PATIENCE_S)
        self._bus.shutdown()


@pytest.fixture
def drive() -> Iterator[LiveDrive]:
    live = LiveDrive(can.Bus(interface="local", channel="can0"))
    live.start()
    yield live
    live.end()


@pytest.fixture
def network(drive: LiveDrive) -> Iterator[canopen.Network]:
    net = canopen.Network()
    net.connect(interface="local", channel="can0")
    yield net
    net.sync.stop()
    net.disconnect()


@pytest.fixture
def client(network: canopen.Network) -> BaseNode402:
    node = BaseNode402(NODE, str(cia301.EDS))
    network.add_node(patient(node))
    node.nmt.state = "RESET COMMUNICATION"
    assert node.sdo[0x1018][2].raw == 0x402  # frames keep their order: its boot-up message came before this answer
    return node


def test_it_boots_and_reports_its_network_state(client: BaseNode402) -> None:
    assert client.nmt.state == "PRE-OPERATIONAL"
    client.sdo[0x1017].raw = 20
    assert client.nmt.wait_for_heartbeat(PATIENCE_S) == "PRE-OPERATIONAL"
    client.nmt.state = "OPERATIONAL"
    deadline = time.monotonic() + PATIENCE_S
    while client.nmt.wait_for_heartbeat(PATIENCE_S) != "OPERATIONAL":
        assert time.monotonic() < deadline


def test_it_reads_and_writes_the_dictionary_expedited_and_in_segments(client: BaseNode402) -> None:
    assert client.sdo[0x1000].raw == 0x00020192
    assert client.sdo[0x1008].raw == "Emulated servo drive, CiA 402 cyclic synchronous torque"
    assert client.sdo["Position actual value"].raw == COUNTS
    client.sdo[0x6076].raw = 162
    assert client.sdo[0x6076].raw == 162
    client.sdo[0x2000].raw = "X axis of the microscope stage"
    assert client.sdo[0x2000].raw == "X axis of the microscope stage"


@pytest.mark.parametrize(
    ("index", "subindex", "code"), [(0x5FFF, 0, 0x06020000), (0x1018, 9, 0x06090011), (0x6064, 0, 0x06010002)]
)
def test_it_gets_cia_301s_abort_codes(client: BaseNode402, index: int, subindex: int, code: int) -> None:
    with pytest.raises(canopen.SdoAbortedError) as refusal:
        client.sdo.download(index, subindex, b"\0\0\0\0")
    assert refusal.value.code == code


def test_it_receives_the_tpdo_on_sync_and_nothing_without(client: BaseNode402, network: canopen.Network) -> None:
    client.tpdo.read()
    client.nmt.state = "OPERATIONAL"
    assert client.sdo[0x1001].raw == 0  # the drive has seen the NMT command: frames keep their order
    received: list[tuple[int, int]] = []
    arrived = threading.Event()
    client.tpdo[1].add_callback(lambda pdo: (received.append((pdo[0x6064].raw, pdo[0x6041].raw)), arrived.set()))
    assert client.sdo[0x6041].raw & 0x6F == 0x40
    assert received == []
    network.sync.transmit()
    assert arrived.wait(PATIENCE_S)
    ((counts, status),) = received
    assert counts == COUNTS
    assert status & 0x4F == 0x40  # switch on disabled


def test_it_takes_the_drive_through_its_states_and_back(
    client: BaseNode402, network: canopen.Network, drive: LiveDrive
) -> None:
    client.setup_402_state_machine()
    client.nmt.state = "OPERATIONAL"
    network.sync.start(0.005)
    client.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
    assert client.op_mode == "CYCLIC SYNCHRONOUS TORQUE"
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED", "QUICK STOP ACTIVE"):
        client.state = state
        assert client.state == state
    client.state = "SWITCH ON DISABLED"
    client.state = "OPERATION ENABLED"
    client.sdo[0x6071].raw = 250  # thousandths of the rated torque, 1 N by default
    client.rpdo[1][0x6071].raw = 250
    client.rpdo[1].transmit()
    deadline = time.monotonic() + PATIENCE_S
    while client.sdo[0x6077].raw != 250:
        assert time.monotonic() < deadline
    assert drive.servo.force == 0.25
    client.state = "SWITCHED ON"
    assert drive.servo.force == 0.0


def test_it_resets_a_fault_and_reads_its_emergencies(
    client: BaseNode402, network: canopen.Network, drive: LiveDrive
) -> None:
    client.setup_402_state_machine()
    client.nmt.state = "OPERATIONAL"
    network.sync.start(0.005)
    client.state = "OPERATION ENABLED"
    drive.servo.fail()
    assert client.emcy.wait(timeout=PATIENCE_S).code == 0x6100
    deadline = time.monotonic() + PATIENCE_S
    while not client.is_faulted():
        client.check_statusword(PATIENCE_S)
        assert time.monotonic() < deadline
    assert client.sdo[0x1003][1].raw == 0x6100
    assert client.sdo[0x603F].raw == 0x6100
    client.reset_from_fault()
    assert client.state == "OPERATION ENABLED"
    assert client.sdo[0x603F].raw == 0
    assert client.emcy.active == []
