"""`hil drive`: a drive in a process of its own, driven by a master that is not ours, the canopen package."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import canopen
import pytest
from typer.testing import CliRunner

from drivers.bus.any_bus import joined
from drivers.config import BusConfig
from hil.cli.app import build_app
from sim_plant.config import EmulatedDriveConfig
from sim_plant.drive_double import DoubleSettings, DriveDouble, make_drive, stated_inputs
from tests.support.foreign_drive import MOTION_DRIVE, eds_text
from tests.support.foreign_master import NODE, PATIENCE_S, eventually, master_of
from tests.support.paths import ROOT


class Double:
    """`hil drive` as a process. said: its lines until now."""

    def __init__(self, eds: Path, *options: str) -> None:
        arguments = [sys.executable, "-m", "hil", "drive", str(eds), "--node", str(NODE), "-i", "local", *options]
        self.process = subprocess.Popen(
            [*arguments, "--orders"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1, cwd=ROOT
        )
        self.said: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.hears("switch on disabled")

    def _read(self) -> None:
        assert self.process.stdout
        self.said.extend(line.strip() for line in self.process.stdout)

    def hears(self, text: str) -> str:
        """The first line that matches, once there is one."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            for line in list(self.said):
                if re.search(text, line):
                    return line
            time.sleep(0.005)
        raise AssertionError(f"{text!r} not in {self.said}")

    def order(self, word: str) -> None:
        assert self.process.stdin
        self.process.stdin.write(f"{word}\n")

    def end(self) -> int:
        self.process.send_signal(signal.SIGINT)
        status = self.process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        return status


@pytest.fixture
def eds(tmp_path: Path) -> Path:
    path = tmp_path / "made.eds"
    path.write_text(eds_text(MOTION_DRIVE))
    return path


@pytest.fixture
def network() -> Iterator[canopen.Network]:
    net = canopen.Network()
    net.connect(interface="local", channel="can0")
    yield net
    net.sync.stop()
    net.disconnect()


@pytest.fixture
def double(eds: Path) -> Iterator[Double]:
    running = Double(eds)
    yield running
    assert running.end() == 0
    assert not [line for line in running.said if "Traceback" in line]


@pytest.fixture
def client(double: Double, network: canopen.Network, eds: Path) -> Any:
    return master_of(network, eds)


@pytest.mark.live
def test_every_transfer_type_carries_the_same_values(client: Any) -> None:
    name = "A servo drive with a name of more than seven bytes"
    assert client.sdo[0x1000].raw == 0x00020192  # expedited
    assert client.sdo[0x1008].raw == name  # segmented
    for crc in (True, False):
        with client.sdo.open(0x1008, mode="rb", block_transfer=True, request_crc_support=crc) as file:
            assert file.read().decode() == name
    for length in (1, 6, 7, 8, 14, 120, 256):
        text = bytes(65 + place % 26 for place in range(length))
        for crc in (True, False):
            with client.sdo.open(
                0x2000, mode="wb", size=length, block_transfer=True, request_crc_support=crc, buffering=7
            ) as file:
                file.write(text)
            assert client.sdo.upload(0x2000, 0) == text
    with pytest.raises(canopen.SdoAbortedError) as refusal:
        client.sdo.open(0x1008, mode="wb", size=4, block_transfer=True)
    assert refusal.value.code == 0x06010002


@pytest.mark.live
def test_a_master_takes_it_through_its_states_and_modes(client: Any, double: Double, network: canopen.Network) -> None:
    client.setup_402_state_machine()
    client.nmt.state = "OPERATIONAL"
    network.sync.start(0.005)
    for mode, shown in (
        ("PROFILED POSITION", "PP"),
        ("PROFILED VELOCITY", "PV"),
        ("PROFILED TORQUE", "TQ"),
        ("HOMING", "HM"),
        ("CYCLIC SYNCHRONOUS POSITION", "CSP"),
        ("CYCLIC SYNCHRONOUS VELOCITY", "CSV"),
        ("CYCLIC SYNCHRONOUS TORQUE", "CST"),
    ):
        client.op_mode = mode
        assert client.op_mode == mode
        double.hears(f"mode {shown}$")
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED", "QUICK STOP ACTIVE", "SWITCH ON DISABLED"):
        client.state = state
        assert client.state == state
        double.hears(state.lower().replace(" active", ""))


@pytest.mark.live
def test_a_master_moves_it_to_a_position(client: Any, network: canopen.Network) -> None:
    client.setup_402_state_machine()
    client.nmt.state = "OPERATIONAL"
    network.sync.start(0.005)
    client.op_mode = "PROFILED POSITION"
    client.state = "OPERATION ENABLED"
    client.sdo[0x6081].raw, client.sdo[0x6083].raw = 100_000, 1_000_000
    client.sdo[0x607A].raw = 4096
    client.sdo[0x6040].raw = 0x1F
    eventually(lambda: client.sdo[0x6041].raw & 0x1400 == 0x1400)  # acknowledged and reached
    eventually(lambda: client.sdo[0x6064].raw == 4096)  # reached: within the window, and on its way into the middle


@pytest.mark.live
def test_a_master_maps_its_pdos_anew(client: Any, network: canopen.Network) -> None:
    client.tpdo.read()
    client.rpdo.read()
    client.nmt.state = "PRE-OPERATIONAL"
    tpdo, rpdo = client.tpdo[1], client.rpdo[1]
    for pdo, objects in ((tpdo, (0x606C, 0x6041)), (rpdo, (0x60FF, 0x6040))):
        pdo.clear()
        for index in objects:
            pdo.add_variable(index)
        pdo.trans_type, pdo.enabled = 1, True
        pdo.save()
    heard = []
    tpdo.add_callback(lambda pdo: heard.append((pdo[0x606C].raw, pdo[0x6041].raw & 0x6F)))
    client.nmt.state = "OPERATIONAL"
    client.sdo[0x6060].raw = 9
    for word, target in ((0x06, 0), (0x07, 0), (0x0F, 700), (0x0F, 700), (0x0F, 700)):
        rpdo[0x6040].raw, rpdo[0x60FF].raw = word, target
        rpdo.transmit()
        before = len(heard)
        network.sync.transmit()
        eventually(lambda before=before: len(heard) > before)  # type: ignore[misc]
    assert heard[-1] == (700, 0x27)


@pytest.mark.live
def test_heartbeats_faults_and_failing_power_are_heard(client: Any, double: Double, network: canopen.Network) -> None:
    client.sdo[0x1017].raw = 10
    assert client.nmt.wait_for_heartbeat(PATIENCE_S) == "PRE-OPERATIONAL"
    client.nmt.state = "OPERATIONAL"
    eventually(lambda: client.nmt.wait_for_heartbeat(PATIENCE_S) == "OPERATIONAL")
    client.setup_402_state_machine()
    network.sync.start(0.005)
    client.state = "OPERATION ENABLED"
    double.order("fault")
    assert client.emcy.wait(timeout=PATIENCE_S).code == 0x6100
    eventually(lambda: client.sdo[0x6041].raw & 0x4F == 0x08)
    double.hears("node 3: .*fault")
    client.reset_from_fault()
    assert client.state == "OPERATION ENABLED"
    boots: list[int] = []
    client.nmt.add_heartbeat_callback(lambda state: boots.append(state) if state == 0 else None)
    double.order("reboot")
    eventually(lambda: bool(boots))
    assert client.sdo[0x1017].raw == 0
    double.order("mute")
    client.sdo.RESPONSE_TIMEOUT = 0.3
    eventually(lambda: not answers(client))
    double.order("unmute")
    eventually(lambda: answers(client))
    double.order("nonsense")
    double.hears("'nonsense' is no order")


def answers(client: Any) -> bool:
    try:
        return bool(client.sdo[0x1000].raw)
    except canopen.SdoCommunicationError:
        return False


@pytest.mark.live
def test_quirks_are_what_a_master_meets(eds: Path, network: canopen.Network) -> None:
    options = (
        "--missing",
        "1017h",
        "--aborts",
        "6060h",
        "--answers",
        "segmented",
        "--status-bits",
        "0x8000",
        "--every",
    )
    double = Double(eds, *options, "--watchdog-s", "0.2", "--boot-s", "0.2")
    try:
        client = canopen.RemoteNode(NODE, str(eds))
        network.add_node(client)
        client.sdo.RESPONSE_TIMEOUT = PATIENCE_S
        assert client.sdo[0x1000].raw == 0x00020192
        for index, code in ((0x1017, 0x06020000), (0x6060, 0x08000000)):
            with pytest.raises(canopen.SdoAbortedError) as refusal:
                client.sdo[index].raw = 10
            assert refusal.value.code == code
        assert client.sdo[0x6041].raw & 0x8000
        double.hears(r"node 3: SDO 1017h:00 aborted with 0x06020000 \(no object\)")
        double.hears("to node 3: SDO read 1000h:00")
    finally:
        assert double.end() == 0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--node", "128"], "less than or equal to 127"),
        (["--node", "3", "--node", "3"], "each needs a number of its own"),
        (["--missing", "10zz"], "missing.0 = '10zz'"),
        (["--status-bits", "1"], "only bits 8, 14 and 15"),
        (["--channel", "a/b"], "channel 'a/b'"),
    ],
)
def test_what_cannot_be_is_refused_before_a_bus_is_opened(options: list[str], said: str, eds: Path) -> None:
    shown = CliRunner().invoke(build_app("drive"), ["drive", str(eds), *options], env={"COLUMNS": "300"})
    assert shown.exit_code == 2
    assert said in shown.output


@pytest.mark.parametrize(
    ("word", "inputs"),
    [
        ("limit+", 0x2),
        ("limits-off", 0),
        ("inputs=0x10004", 0x10004),
        ("inputs=12", 12),
        ("inputs=4294967295", 0xFFFFFFFF),
        ("inputs=4294967296", None),
        ("inputs=-1", None),
        ("inputs=012", None),
        ("inputs=", None),
        ("fault", None),
    ],
)
def test_an_order_may_state_the_inputs(word: str, inputs: int | None) -> None:
    assert stated_inputs(word) == inputs


def test_an_order_reaches_every_drive(eds: Path) -> None:
    quirks = EmulatedDriveConfig(kind="cia402")
    settings = DoubleSettings(1.0, 4096, 1e-3, 1e-3, 0.0, 0.0, quirks)
    drives = [make_drive(eds, number, settings, 0) for number in (1, 2)]
    said: list[str] = []
    with joined(BusConfig(protocol="cia402", interface="virtual", channel="orders"), fd=False) as port:
        double = DriveDouble(drives, port, said.append, every=False)
        for word in ("block", "inputs=9", "inputs=VALUE"):
            double.order(word)
    assert [(drive.blocked, drive.inputs) for drive in drives] == [(True, 9)] * 2
    double.order("unblock")
    assert not any(drive.blocked for drive in drives)
    assert [line.split(" is ")[0] for line in said] == ["'inputs=VALUE'"]


def test_a_file_that_is_no_eds_is_named(tmp_path: Path) -> None:
    (tmp_path / "no.eds").write_bytes(os.urandom(100))
    shown = CliRunner().invoke(build_app("drive"), ["drive", str(tmp_path / "no.eds"), "-i", "local"])
    assert shown.exit_code == 74
    assert "no.eds" in shown.output
