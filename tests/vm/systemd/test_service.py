"""The installed service on a fresh guest with systemd as init: docs/at-the-rig.md, followed step by step.

Runs inside the second guest of the VM lane (deploy/vm/test_systemd.sh), with Debian's own Python and nothing of the
project but its package. The tests are one story in the order of the file.
"""

import json
import os
import re
import signal
import subprocess
import time
from pathlib import Path

import pytest

pytestmark = [pytest.mark.vcan, pytest.mark.systemd]

PATIENCE_S = 300.0  # software emulation on a busy machine; only ever waited out by a failure
PACKAGES = Path("/share/packages")
RIG = Path("/etc/hil/rigs/microscope.toml")
CONTROL, SIDECAR, EMULATOR = (f"hil-{part}@microscope.service" for part in ("control", "sidecar", "emulator"))
EX_CONFIG = 78

# The one edit: this guest is fifty times slower than a rig's PC, and promises no timing at all.
EDIT = {
    r"^rate_hz = .*$": "rate_hz = 50",
    r"^kp = .*$": "kp = [150.0, 100.0, 40.0, 0.033]",
    r"^kd = .*$": "kd = [16.0, 11.0, 4.5, 0.0036]",
    r"following_error = [0-9.e-]+": "following_error = 0.02",
    r'^kind = "injection"$': 'kind = "hold"',
    r"^allow_degraded = .*$": "allow_degraded = true",
    r"^\[plant\]$": "[safety]\nsilent_stop_ticks = 250\nsilent_zero_ticks = 500\noverrun_zero_s = 5.0\n"
    "overrun_streak = 2500\n\n[plant]\nwatchdog_s = 1.0",
}
SLOW_WATCHDOG = "[Service]\nWatchdogSec=20\n"


def sh(command: str, *, ok: bool = True) -> str:
    """Output of a shell command that must succeed (unless not ok)."""
    done = subprocess.run(command, shell=True, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert not ok or done.returncode == 0, f"{command}: {done.returncode}\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr


def show(unit: str, prop: str) -> str:
    """One property of a unit."""
    return sh(f"systemctl show --value --property={prop} '{unit}'").strip()


def eventually(holds, what: str) -> None:
    """Wait until `holds()`; fail with the services' journal."""
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        if time.monotonic() > deadline:
            told = sh("systemctl status --no-pager -n 25 'hil-*'; hil monitor microscope --once", ok=False)
            pytest.fail(f"not within {PATIENCE_S:.0f} s: {what}\n{told}")
        time.sleep(0.5)


def status(*states: str) -> bool:
    """Whether `systemctl status` shows one of the states."""
    return show(CONTROL, "StatusText").split(",")[0] in states


def command(action: str) -> bool:
    """An operator's command through the gateway; whether it was taken."""
    return subprocess.run(["hil", "command", str(RIG), action], timeout=PATIENCE_S, check=False).returncode == 0


def to_ready() -> None:
    """By resets, where it takes them, as the page for the rig says."""

    def ready() -> bool:
        return status("READY") or (command("reset") and status("READY"))

    eventually(ready, "READY")


def main_pid() -> int:
    return int(show(CONTROL, "MainPID"))


def drives() -> dict:
    """What the emulated drives say of themselves."""
    return json.loads(Path("/run/hil/microscope/emulator.json").read_text())


def no_torque() -> bool:
    return all(axis["applied_force"] == 0.0 for axis in drives()["axes"].values())


@pytest.fixture(autouse=True)
def _story_goes_on(request):
    """A step that failed makes the following ones meaningless: say so instead of failing them for other reasons."""
    if getattr(request.session, "broken", None):
        pytest.fail(f"an earlier step failed: {request.session.broken}")
    yield
    if request.session.testsfailed:
        request.session.broken = request.node.name


def test_the_package_installs_without_a_network():
    assert "linux" in sh("uname -a").lower()
    assert os.readlink("/proc/1/exe").endswith("systemd")
    package = next(PACKAGES.glob("hil_*.deb"))
    sh(f"DEBIAN_FRONTEND=noninteractive apt-get install -y {package}")
    assert RIG.exists()
    assert "hil" in sh("id hil")
    assert show("hil.target", "ActiveState") == "inactive", "installing starts nothing"


def test_units_are_clean_and_hardened():
    for unit in (CONTROL, SIDECAR, EMULATOR, "hil.target"):
        assert sh(f"systemd-analyze verify '{unit}'") == ""
    for unit in (CONTROL, SIDECAR, EMULATOR):
        report = sh(f"systemd-analyze security --no-pager '{unit}'")
        exposure = float(re.search(r"exposure level for \S+: ([0-9.]+)", report)[1])
        print(unit, exposure)
        assert exposure <= 2.5, report


def test_one_rig_file_is_edited_and_checked():
    text = RIG.read_text()
    for pattern, replacement in EDIT.items():
        text, found = re.subn(pattern, replacement, text, flags=re.MULTILINE)
        assert found, pattern
    assert 'channel = "vcan0"' in text
    RIG.write_text(text)
    for unit in ("hil-control@.service",):
        directory = Path(f"/etc/systemd/system/{unit}.d")
        directory.mkdir(parents=True)
        (directory / "slow.conf").write_text(SLOW_WATCHDOG)
    sh("systemctl daemon-reload")


def test_the_target_starts_everything_and_status_shows_the_state():
    sh("systemctl start hil.target")
    eventually(lambda: show(CONTROL, "ActiveState") == "active", "the control unit is active")
    eventually(lambda: show(SIDECAR, "ActiveState") == show(EMULATOR, "ActiveState") == "active", "all run")
    assert Path("/sys/class/net/vcan0/mtu").read_text().strip() == "72"
    eventually(lambda: status("CONNECTED", "READY", "FAULT"), "a state is shown")
    assert not status("ACTIVE"), "it never activates by itself"
    assert "Status: " in sh(f"systemctl status --no-pager '{CONTROL}'")
    owner = sh(f"ps -o user= -p {main_pid()}").strip()
    assert owner == "hil", "nothing runs as root"


def test_the_loop_closes_and_a_monitor_sees_it():
    eventually(lambda: "microscope" in sh("hil monitor microscope --once", ok=False), "telemetry over Zenoh")
    to_ready()
    assert command("activate")
    eventually(lambda: status("ACTIVE"), "ACTIVE")
    assert "ACTIVE" in sh("hil monitor microscope --once")
    assert "0x" not in drives()["axes"]["x"]["status"]
    assert command("stop")
    eventually(lambda: status("READY"), "READY after a stop")


def test_real_time_is_granted_without_root():
    policy = sh(f"chrt -p {main_pid()}") if Path("/usr/bin/chrt").exists() else ""
    assert not policy or "SCHED_FIFO" in policy
    journal = sh(f"journalctl --no-pager -u '{CONTROL}'")
    assert re.search(r"hil run: microscope at 50 Hz on vcan0", journal), journal
    print(re.findall(r"hil run: .*", journal)[:2])
    assert "SCHED_FIFO" in journal
    assert "refused" not in journal, "priority, memory and DMA latency are granted to the service's own user"


def test_the_doctor_tells_the_truth_inside_the_guest():
    findings = {f["topic"]: f for f in json.loads(sh("hil doctor --json"))["findings"]}
    assert findings["CAN vcan0"]["detail"].startswith("up, CAN FD")
    assert "PREEMPT_RT" in findings["kernel"]["detail"]
    assert findings["cyclictest"]["level"] != "ok", "it is not installed here, and the doctor must not say so"


def test_networkd_sets_a_real_controller_to_the_bit_rate_of_the_rig_file(tmp_path):
    rig = tmp_path / "classic.toml"
    text = RIG.read_text().replace('name = "microscope"', 'name = "classic"', 1)
    text = text.replace('protocol = "stage_fd"', 'protocol = "stage_classic"\nbitrate = 500000\ntransmit_queue = 7')
    rig.write_text(text)
    sh("modprobe kvaser_pci")
    sh(f"hil install --rig {rig} --channel can0")

    def configured() -> bool:
        link = json.loads(sh("ip -json -details link show can0"))[0]
        info = link["linkinfo"]["info_data"]
        return "UP" in link["flags"] and info.get("bittiming", {}).get("bitrate") == 500000

    eventually(configured, "can0 is up at 500 kbit/s")
    assert json.loads(sh("ip -json -details link show can0"))[0]["linkinfo"]["info_data"].get("restart_ms", 0) == 0
    sh("udevadm trigger --settle --action=add /sys/class/net/can0")
    assert Path("/sys/class/net/can0/tx_queue_len").read_text().strip() == "7"
    sh("rm /etc/systemd/system/hil.target.wants/*@classic.service && systemctl daemon-reload")


def test_a_killed_control_process_comes_back_connected_and_never_active():
    to_ready()
    assert command("activate")
    eventually(lambda: status("ACTIVE"), "ACTIVE")
    sh(f"systemctl stop '{SIDECAR}'")  # nobody records: what is left is the black box alone
    killed = main_pid()
    os.kill(killed, signal.SIGKILL)
    eventually(no_torque, "the drives' watchdogs have cut the torque")
    eventually(lambda: main_pid() not in (0, killed) and status("CONNECTED", "READY", "FAULT"), "restarted")
    assert int(show(CONTROL, "NRestarts")) >= 1
    time.sleep(2)
    assert not status("ACTIVE")
    sh(f"systemctl start '{SIDECAR}'")
    last_ticks = "a control process was killed earlier; its last ticks are in"
    eventually(lambda: last_ticks in sh(f"journalctl --no-pager -u '{SIDECAR}'"), "the black box is found and saved")
    eventually(lambda: "microscope" in sh("hil monitor microscope --once", ok=False), "telemetry again")


def test_a_wedged_loop_is_killed_by_the_watchdog_and_the_drives_are_at_zero():
    to_ready()
    assert command("activate")
    eventually(lambda: status("ACTIVE"), "ACTIVE")
    wedged = main_pid()
    os.kill(wedged, signal.SIGSTOP)
    eventually(no_torque, "the drives' watchdogs have cut the torque")
    eventually(lambda: main_pid() not in (0, wedged), "the watchdog has killed it and systemd started another")
    assert "watchdog" in sh(f"journalctl --no-pager -u '{CONTROL}'").lower()
    eventually(lambda: status("CONNECTED", "READY", "FAULT"), "connected again")
    assert not status("ACTIVE")


def test_a_can_device_that_is_removed_and_added_stops_and_starts_the_service():
    sh("ip link delete vcan0")
    eventually(lambda: show(CONTROL, "ActiveState") in ("inactive", "failed"), "stopped with its device")
    sh("ip link add vcan0 type vcan && ip link set vcan0 mtu 72 up")
    eventually(lambda: show(CONTROL, "ActiveState") == "active", "started with its device")
    eventually(lambda: show(EMULATOR, "ActiveState") == "active", "and the emulator too")
    to_ready()


def test_a_bad_rig_file_ends_with_78_and_no_restart_loop():
    good = RIG.read_text()
    RIG.write_text(good.replace("rate_hz = 50", "rate_hz = -50"))
    sh(f"systemctl restart '{CONTROL}'", ok=False)
    eventually(lambda: show(CONTROL, "ActiveState") == "failed", "the unit has failed")
    assert show(CONTROL, "ExecMainStatus") == str(EX_CONFIG)
    restarts = show(CONTROL, "NRestarts")
    time.sleep(5)  # several times RestartSec
    assert show(CONTROL, "NRestarts") == restarts
    assert show(CONTROL, "ActiveState") == "failed"
    assert "rate_hz" in sh(f"journalctl --no-pager -n 20 -u '{CONTROL}'"), "the journal names the key"
    RIG.write_text(good)
    sh(f"systemctl reset-failed '{CONTROL}' && systemctl start '{CONTROL}'")
    eventually(lambda: status("CONNECTED", "READY"), "running again")


def test_an_upgrade_keeps_the_rig_file_and_does_not_stop_the_rig():
    before, pid = RIG.read_text(), main_pid()
    package = next((PACKAGES / "upgrade").glob("hil_*.deb"))
    sh(f"DEBIAN_FRONTEND=noninteractive apt-get install -y {package}")
    assert RIG.read_text() == before
    assert main_pid() == pid, "a stage may be moving: when to restart is the operator's decision"
    assert "99.0" in sh("dpkg-query -W hil")


def test_stop_and_removal_leave_no_process_and_no_unit():
    sh("systemctl stop hil.target")
    for unit in (CONTROL, SIDECAR, EMULATOR):
        assert show(unit, "ActiveState") == "inactive", unit
    assert show(CONTROL, "ExecMainStatus") == "0", "SIGTERM ends it in zero torque and status 0"
    sh("DEBIAN_FRONTEND=noninteractive apt-get remove -y hil")
    assert not Path("/usr/bin/hil").exists()
    assert not list(Path("/etc/systemd/system").glob("hil*control*/rig.conf"))
    assert RIG.exists(), "the rig file is the user's"
