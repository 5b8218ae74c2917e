"""What systemd does when something goes wrong: killed, wedged, unplugged, misconfigured, refused, talkative."""

import os
import re
import signal
import time
from pathlib import Path

import pytest

from tests.vm.systemd.service import Rig, eventually, sh

pytestmark = [pytest.mark.vcan, pytest.mark.systemd]

RIG = Rig("microscope")
DROP_INS = Path("/run/systemd/system/hil-control@.service.d")
EX_NOPERM, EX_CONFIG = 77, 78
SEVERAL_RESTARTS_S = 5  # RestartSec is 1
FLOOD = 20_000  # lines; LogRateLimitBurst allows 1000 in 10 s, of which journald makes up to 6000 on a disk with room


def drop_in(text: str) -> None:
    """Until the next call, [Service] of the control unit says this as well."""
    DROP_INS.mkdir(parents=True, exist_ok=True)
    (DROP_INS / "test.conf").write_text(f"[Service]\n{text}\n")
    sh("systemctl daemon-reload")


def never_activates() -> None:
    time.sleep(2)
    assert not RIG.shows("ACTIVE")


def fails_for_good(status: int) -> None:
    """The unit has failed with this status, and is not tried again."""
    eventually(lambda: RIG.control.state == "failed", "the unit has failed")
    assert RIG.control.show("ExecMainStatus") == str(status)
    restarts = RIG.control.show("NRestarts")
    time.sleep(SEVERAL_RESTARTS_S)
    assert RIG.control.show("NRestarts") == restarts
    assert RIG.control.state == "failed"


def test_a_killed_control_process_comes_back_connected_and_never_active():
    sh("systemctl start hil.target")
    eventually(RIG.monitored, "telemetry over Zenoh")
    RIG.activate()
    sh(f"systemctl stop '{RIG.sidecar}'")  # nobody records: what is left is the black box alone
    killed = RIG.control.pid
    os.kill(killed, signal.SIGKILL)
    eventually(RIG.no_torque, "the drives' watchdogs have cut the torque")
    eventually(lambda: RIG.control.pid not in (0, killed) and RIG.shows("CONNECTED", "READY", "FAULT"), "restarted")
    assert int(RIG.control.show("NRestarts")) >= 1
    never_activates()


def test_the_black_box_of_the_killed_process_survives():
    sh(f"systemctl start '{RIG.sidecar}'")
    pattern = r"a control process was killed earlier; its last ticks are in (\S+)"
    eventually(lambda: re.search(pattern, RIG.sidecar.journal), "the black box is found and saved")
    saved = Path("/var/lib/hil", re.search(pattern, RIG.sidecar.journal)[1])
    assert saved.stat().st_size > 0
    assert saved.owner() == "hil"
    eventually(RIG.monitored, "telemetry again")


def test_a_wedged_loop_is_killed_by_the_watchdog_and_the_drives_are_at_zero():
    RIG.activate()
    wedged = RIG.control.pid
    os.kill(wedged, signal.SIGSTOP)
    eventually(RIG.no_torque, "the drives' watchdogs have cut the torque")
    eventually(lambda: RIG.control.pid not in (0, wedged), "the watchdog has killed it and systemd started another")
    journal = sh(f"journalctl --no-pager -u '{RIG.control}'")  # with what systemd itself says of the unit
    assert "Watchdog timeout" in journal
    RIG.wait_for("CONNECTED", "READY", "FAULT")
    never_activates()


def test_a_can_device_that_is_removed_and_added_stops_and_starts_the_service():
    sh("ip link delete vcan0")
    eventually(lambda: RIG.control.state in ("inactive", "failed"), "stopped with its device")
    sh("ip link add vcan0 type vcan && ip link set vcan0 mtu 72 up")
    eventually(lambda: RIG.control.state == "active", "started with its device")
    eventually(lambda: RIG.emulator.state == "active", "and the emulator too")
    RIG.to_ready()


def test_a_bad_rig_file_ends_with_78_and_no_restart_loop():
    good = RIG.file.read_text()
    RIG.edit({"^rate_hz = .*$": "rate_hz = -50"})
    sh(f"systemctl reset-failed; systemctl restart '{RIG.control}'", ok=False)
    fails_for_good(EX_CONFIG)
    assert "rate_hz" in RIG.control.journal, "the journal names the key"
    RIG.file.write_text(good)


def test_refused_real_time_ends_with_77_and_no_restart_loop():
    good = RIG.file.read_text()
    RIG.edit({"^allow_degraded = true$": "allow_degraded = false"})
    drop_in("AmbientCapabilities=\nCapabilityBoundingSet=\nLimitRTPRIO=0")
    sh(f"systemctl reset-failed '{RIG.control}'; systemctl start '{RIG.control}'", ok=False)
    fails_for_good(EX_NOPERM)
    assert "priority refused" in RIG.control.journal
    RIG.file.write_text(good)


def test_a_talkative_service_does_not_fill_the_journal():
    enough = Path("/run/enough-said")
    drop_in(f"ExecStartPre=/bin/sh -c 'seq {FLOOD}; until [ -e {enough} ]; do echo more; sleep 1; done'")
    sh(f"systemctl reset-failed; systemctl start --no-block '{RIG.control}'")
    eventually(lambda: "more" in RIG.control.journal.split(), "when its time is up, it is heard again")
    assert "Suppressed" in sh("journalctl --no-pager -o cat -u systemd-journald")
    enough.touch()
    kept = re.findall(r"^\d+$", RIG.control.journal, flags=re.MULTILINE)
    assert kept[:3] == ["1", "2", "3"]
    assert len(kept) < FLOOD / 2
    drop_in("")
    RIG.to_ready()
    sh("systemctl stop hil.target")
