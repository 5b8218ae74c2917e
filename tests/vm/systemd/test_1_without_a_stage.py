"""Sections 1 and 2 of the page for the rig: the package on a fresh machine, one rig file edited, the loop closed."""

import json
import os
import re
from pathlib import Path

import pytest

from tests.vm.doctor_truth import untruths
from tests.vm.systemd.page import CtrlC, follow, says
from tests.vm.systemd.service import EDIT, Rig, Unit, eventually, sh

pytestmark = [pytest.mark.vcan, pytest.mark.systemd]

MICROSCOPE = Rig("microscope")
TARGET = Unit("hil.target")
# This guest runs when its host has time: the service's watchdog must be as patient as its drives are made below, and
# its start, four seconds on a PC, has taken more than two minutes beside other work.
PATIENT = "[Service]\nWatchdogSec=20\nTimeoutStartSec=600\n"
HIGHEST_EXPOSURE = 2.5


def installed(output: str) -> None:
    assert MICROSCOPE.file.exists()
    assert "hil" in sh("id hil")
    assert TARGET.state == "inactive", "installing starts nothing"
    control_path = sh("hil --version").split()[-1]
    assert f"control path is {control_path}." in sh("dpkg-query --show --showformat '${Description}' hil")


def test_section_1_install():
    assert os.readlink("/proc/1/exe").endswith("systemd")
    assert not any(re.match(r"(eth|en|wl)", name) for name in os.listdir("/sys/class/net")), "there is no network"
    os.chdir("/share/packages")
    follow("1", {}, {"apt install": installed, "hil doctor": says("PREEMPT_RT", "SCHED_FIFO")})


def test_the_doctor_tells_the_truth_here():
    sh("ip link add dev vcan9 type vcan && ip link set vcan9 mtu 16")
    try:
        assert untruths(json.loads(sh("hil doctor --json"))["findings"]) == []
    finally:
        sh("ip link delete vcan9")


def test_units_are_clean_and_hardened():
    for unit in (MICROSCOPE.control, MICROSCOPE.sidecar, MICROSCOPE.emulator, TARGET):
        assert sh(f"systemd-analyze verify '{unit}'") == ""
    for unit in (MICROSCOPE.control, MICROSCOPE.sidecar, MICROSCOPE.emulator):
        report = sh(f"systemd-analyze security --no-pager '{unit}'")
        exposure = float(re.search(r"exposure level for \S+: ([0-9.]+)", report)[1])
        print(unit, exposure)
        assert exposure <= HIGHEST_EXPOSURE, report


def started(output: str) -> None:
    eventually(lambda: MICROSCOPE.sidecar.state == MICROSCOPE.emulator.state == "active", "all run")
    MICROSCOPE.wait_for("CONNECTED", "READY", "FAULT")
    assert Path("/sys/class/net/vcan0/mtu").read_text().strip() == "72"
    eventually(MICROSCOPE.monitored, "telemetry over Zenoh")


def status_is_shown(output: str) -> None:
    assert re.search(r'Status: "(CONNECTED|READY|FAULT)', output), "it never activates by itself"
    for unit in (MICROSCOPE.control, MICROSCOPE.sidecar, MICROSCOPE.emulator):
        assert sh(f"ps -o user= -p {unit.pid}").strip() == "hil", "nothing runs as root"
    MICROSCOPE.to_ready()


def the_loop_is_closed(output: str) -> None:
    def shown() -> bool:
        MICROSCOPE.activate()  # again, where this guest was not let run meanwhile: a monitor takes it half a minute
        monitored = re.search(r"\bACTIVE\b", sh("hil monitor microscope --once"))
        return bool(monitored) and "ACTIVE" in sh(f"systemctl status --no-pager '{MICROSCOPE.control}'")

    eventually(shown, "a monitor and systemctl show it ACTIVE")


def everything_has_ended(output: str) -> None:
    for unit in (MICROSCOPE.control, MICROSCOPE.sidecar, MICROSCOPE.emulator):
        assert unit.state == "inactive", unit
    assert MICROSCOPE.control.show("ExecMainStatus") == "0", "SIGTERM ends it in zero torque and status 0"


def test_section_2_one_rig_file_is_edited_and_the_loop_closes():
    MICROSCOPE.edit(EDIT)
    assert 'channel = "vcan0"' in MICROSCOPE.file.read_text()
    directory = Path("/etc/systemd/system/hil-control@.service.d")
    directory.mkdir(parents=True)
    (directory / "slow.conf").write_text(PATIENT)
    sh("systemctl daemon-reload")
    follow(
        "2",
        {},
        {
            "hil check": says("stable"),
            "systemctl start": started,
            "systemctl status": status_is_shown,
            "hil monitor": CtrlC("READY", MICROSCOPE.recover),
            "hil command /etc/hil/rigs/microscope.toml activate": the_loop_is_closed,
            "hil command /etc/hil/rigs/microscope.toml stop": lambda _: MICROSCOPE.to_ready(),
            "systemctl stop": everything_has_ended,
        },
    )


def test_real_time_is_granted_without_root_and_the_journal_says_so():
    journal = MICROSCOPE.control.journal
    assert re.search(r"hil run: microscope at 20 Hz on vcan0", journal), journal
    assert "SCHED_FIFO" in journal
    verdict = [line for line in journal.splitlines() if line.startswith("hil run:")]
    assert "refused" not in "\n".join(verdict), "priority, memory and DMA latency are granted to the service's own user"


def test_the_filters_design_is_kept_for_the_next_start():
    (kept,) = Path("/var/cache/hil/designs").iterdir()
    assert kept.owner() == "hil"
    assert kept.stat().st_mode & 0o077 == 0
