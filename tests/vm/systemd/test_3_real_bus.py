"""Sections 3 to 5 and 7 of the page for the rig: a CAN controller behind its real driver, the stage across the bus.

The stage's controller lives in a network namespace of its own: the service reaches it over the bus and in no other way.
"""

import contextlib
import json
import re
import shutil
from pathlib import Path

import pytest

from tests.vm.slcan import SerialAdapter
from tests.vm.systemd.brought import BESIDE, CLASSES
from tests.vm.systemd.page import CtrlC, follow, says, whatever
from tests.vm.systemd.service import EDIT, RIGS, console, edited, eventually, sh
from tests.vm.systemd.stage import CHANNEL, NAMESPACE, STAGE, its_controller, remember_controller

pytestmark = [pytest.mark.vcan, pytest.mark.systemd]

BITRATE, QUEUE = 500_000, 7
ARPHRD_CAN = "280"
ENABLED = 1  # DriveStatus.ENABLED
# The shipped microscope, as somebody would write it down for a stage of their own on classic CAN, with a law, an
# estimator and a path of their own beside the rig file.
PATH = "time_s,x,y\n0,0,0\n2,0.0005,0\n4,0.001,0.0005\n6,0.001,0.001\n8,0.001,0.001\n"
OWN_RIG = {
    **EDIT,
    **CLASSES,
    r'^kind = "injection"$': 'kind = "path"\nfile = "slow.csv"',
    '^name = "microscope"$': 'name = "stage"',
    '^protocol = "stage_fd"$': f'protocol = "stage_classic"\nbitrate = {BITRATE}\ntransmit_queue = {QUEUE}',
    '^channel = "can0"$': f'channel = "{CHANNEL}"',
}
SHIPPED = Path("/usr/share/hil/rigs/microscope.toml")


def interfaces() -> set[str]:
    """CAN controllers in this network namespace, by name."""
    found = set()
    for kind in Path("/sys/class/net").glob("*/type"):
        with contextlib.suppress(OSError):  # pulled out, or renamed by udev, since it was listed
            if kind.read_text().strip() == ARPHRD_CAN:
                found.add(kind.parent.name)
    return {name for name in found if not name.startswith("vcan")}


def link(name: str) -> dict:
    """What `ip` knows of an interface."""
    return json.loads(sh(f"ip -json -details link show {name}"))[0]


def other_controller() -> str:
    (name,) = interfaces() - {CHANNEL}
    return name


def test_section_3_the_adapter_gets_a_name_of_its_own():
    sh("modprobe kvaser_pci")
    eventually(lambda: len(interfaces()) == 2, "both controllers")
    sh("udevadm settle")
    where = re.search(r"ID_PATH=(\S+)", sh("udevadm info /sys/class/net/can0"))[1]
    follow(
        "3",
        {"pci-0000:00:14.0-usb-0:2:1.0": where},
        {"udevadm info": says(where), "cat >": whatever, "udevadm control": whatever},
    )
    sh("modprobe -r kvaser_pci && modprobe kvaser_pci")
    eventually(lambda: CHANNEL in interfaces(), "plugged in again, it has its own name")
    assert link(CHANNEL)["txqlen"] == 16


def stage_moves_out() -> None:
    """The other controller goes into the stage's network namespace, at the same bit rate."""
    name = other_controller()
    sh(f"ip netns add {NAMESPACE} && ip link set {name} netns {NAMESPACE}")
    sh(f"ip -n {NAMESPACE} link set {name} up type can bitrate {BITRATE}")
    remember_controller(name)


def no_rig_is_left(output: str) -> None:
    assert list(RIGS.glob("*.toml")) == []


def as_the_rig_file_says(output: str) -> None:
    def configured() -> bool:
        info = link(CHANNEL)["linkinfo"]["info_data"]
        return "UP" in link(CHANNEL)["flags"] and info.get("bittiming", {}).get("bitrate") == BITRATE

    eventually(configured, "networkd has set the bit rate")
    told = sh(f"ip -details link show {CHANNEL}")
    assert f"bitrate {BITRATE}" in told
    assert "ERROR-ACTIVE" in told
    assert "restart-ms 0" in told, "the kernel must not bring a controller back by itself"


def test_section_4_the_rig_is_installed(tmp_path):
    sh("systemctl stop systemd-networkd.socket systemd-networkd")  # as where somebody else manages the network
    own = tmp_path / "my-stage.toml"
    own.write_text(edited(SHIPPED.read_text(), OWN_RIG))
    (tmp_path / "slow.csv").write_text(PATH)
    for source in BESIDE:
        shutil.copy(source, tmp_path)
    stage_moves_out()
    follow(
        "4",
        {"can0": CHANNEL, "my-stage.toml": str(own)},
        {
            "hil uninstall --purge": no_rig_is_left,
            "hil install --rig": says(str(STAGE.file)),
            "systemctl reload-or-restart": whatever,
            "ip -details link show": as_the_rig_file_says,
        },
    )


def test_the_transmit_queue_of_an_interface_without_a_name_of_its_own_is_set_too():
    own = Path("/etc/systemd/network/10-stage.link")
    text = own.read_text()
    own.unlink()
    sh(f"hil install --rig {STAGE.file}")
    assert link(CHANNEL)["txqlen"] == QUEUE
    own.write_text(text)


def everything_answers(output: str) -> None:
    STAGE.wait_for("CONNECTED", "READY", "FAULT")
    eventually(STAGE.monitored, "telemetry over Zenoh")
    STAGE.to_ready()


def nothing_is_enabled(output: str) -> None:
    assert re.search(r'Status: "READY', output)
    assert STAGE.no_torque()
    assert not any(int(axis["status"]) & ENABLED for axis in STAGE.drives().values())


def ready_again(output: str) -> None:
    STAGE.to_ready()
    assert STAGE.no_torque()


def holds_its_place(output: str) -> None:
    STAGE.activate()


def test_section_5_first_power_up(request):
    def power_on(output: str) -> None:
        assert "state ERROR-ACTIVE (berr-counter tx 0 rx 0)" in output
        request.getfixturevalue("powered_stage")

    somebody = f"ip netns exec {NAMESPACE} cansend {its_controller()} 100#BEEF"
    follow(
        "5",
        {"can0": CHANNEL, "NAME": STAGE.name, "RIG": str(STAGE.file)},
        {
            "ip -details -statistics link show": power_on,
            "candump": CtrlC("100 .*BE EF", lambda: sh(somebody)),  # the drives wait to be spoken to
            "systemctl start hil.target": everything_answers,
            "systemctl status": nothing_is_enabled,
            "hil monitor": CtrlC("READY", STAGE.recover),
            "hil command RIG estop": lambda _: STAGE.wait_for("ESTOP"),
            "hil command RIG reset": ready_again,
            "hil check": says("stable"),
            "systemctl restart hil.target": everything_answers,
            "hil command RIG activate": holds_its_place,
            "hil command RIG stop": lambda _: STAGE.to_ready(),
            "systemctl enable hil.target": says("multi-user.target.wants"),
        },
    )


def test_an_adapter_pulled_out_while_the_stage_moves_and_plugged_in_again():
    STAGE.activate()
    Path(f"/sys/class/net/{CHANNEL}/device/remove").write_text("1")
    eventually(lambda: STAGE.control.state in ("inactive", "failed"), "stopped with its adapter")
    eventually(STAGE.no_torque, "the drives' watchdogs have cut the torque")
    Path("/sys/bus/pci/rescan").write_text("1")
    eventually(lambda: STAGE.control.state == "active", "started with its adapter")
    STAGE.to_ready()
    assert not STAGE.shows("ACTIVE")


def test_section_7_a_fault_is_read():
    STAGE.activate()
    sh(f"ip link set {CHANNEL} down")
    STAGE.wait_for("FAULT")
    follow(
        "7",
        {"NAME": STAGE.name, "RIG": str(STAGE.file)},
        {
            "systemctl status": says('Status: "FAULT'),
            "journalctl": says(f"hil run: stage at 20 Hz on {CHANNEL}"),
            "hil events": says("fault latched: interface_down"),
            "hil monitor": CtrlC("INTERFACE_DOWN"),
            "hil blackbox": says("nothing to save"),  # the sidecar has recorded everything
        },
    )
    sh(f"ip link set {CHANNEL} up")
    STAGE.to_ready()


def test_bus_off_stays_until_an_operators_reset_which_needs_no_root_in_the_service():
    sh("modprobe slcan")
    adapter = SerialAdapter()
    sh(f"hil install --rig {STAGE.file} --replace --channel {adapter.name}")
    eventually(lambda: "UP" in link(adapter.name)["flags"], "networkd has brought it up")
    adapter.heard("S6")  # Lawicel: 500 kbit/s, the rig file's
    adapter.heard("O")
    sh("systemctl restart hil.target")
    STAGE.wait_for("CONNECTED", "FAULT")
    eventually(STAGE.monitored, "telemetry over Zenoh")
    STAGE.reset_to("CONNECTED")
    adapter.state("b", 0, 256)
    STAGE.wait_for("FAULT")
    eventually(lambda: "BUS_OFF" in console(f"monitor {STAGE.name} --once")[1], "the monitor names it")
    assert link(adapter.name)["linkinfo"]["info_data"]["state"] == "BUS-OFF", "nobody has restarted it"
    assert not STAGE.order("activate")
    STAGE.reset_to("CONNECTED")
    adapter.heard("O")
    assert link(adapter.name)["linkinfo"]["info_data"]["state"] == "ERROR-ACTIVE"
    adapter.close()
    eventually(lambda: STAGE.control.state in ("inactive", "failed"), "stopped with its adapter")
    sh(f"hil install --rig {STAGE.file} --replace --channel {CHANNEL} && systemctl restart hil.target")
    STAGE.to_ready()
