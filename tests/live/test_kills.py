"""However and whenever a control process ends: its drives are at zero within their watchdog, and stay there."""

import os
import random
import signal
import subprocess
import threading
import time
from pathlib import Path

import pytest

from drivers.protocols.base import DriveStatus
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.mailbox import MailboxError
from hil.live.runtime_paths import runtime_paths
from hil.operate.stalls import STALL_FAULTS
from tests.support.live_rig import PATIENCE_S, Control, Emulator, emulated, order

pytestmark = pytest.mark.live
WATCHDOG = ("drives.watchdog_s=0.01",)
PATIENT = ("drives.watchdog_s=0.25",)  # where the story must get as far as ACTIVE on a machine that stalls for 20 ms
MOMENTS = int(os.environ.get("HIL_KILLS", "200"))
CHUNKS = 8
LATEST_S = 2.5  # after the start: interpreter, set-up, CONNECTED, READY and ACTIVE all lie before


class EagerOperator(threading.Thread):
    """Asks for ACTIVE over and over, as no operator should: the cycle takes it in READY alone."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.ended = threading.Event()

    def run(self) -> None:
        while not self.ended.wait(0.05):
            if runtime_paths("paper").mailbox.exists():
                try:
                    order(CommandKind.ACTIVATE)
                except (OSError, ValueError, MailboxError):
                    continue  # it is just being replaced, or full: the process no longer takes anything


def wait_for_zero(emulator: Emulator) -> None:
    limit = time.monotonic() + PATIENCE_S
    while any(emulator.stage.applied_force):
        assert time.monotonic() < limit, f"the drives still apply {emulator.stage.applied_force}"
        time.sleep(0.002)


def wait_for_trips(emulator: Emulator) -> None:
    limit = time.monotonic() + PATIENCE_S
    while not all(drive.status & DriveStatus.WATCHDOG for drive in emulator.stage.drives):
        assert time.monotonic() < limit, "a drive's watchdog did not trip"
        time.sleep(0.005)


def check_trips(emulator: Emulator) -> None:
    """Every watchdog expired exactly when it had to, by the emulator's clock."""
    for drive in emulator.stage.drives:
        for trip in drive.trips:
            assert trip.expired_ns - trip.command_ns == drive.watchdog_ns


def end_it(control: Control, how: signal.Signals, emulator: Emulator) -> None:
    control.process.send_signal(how)
    if how is signal.SIGSTOP:
        wait_for_zero(emulator)
        time.sleep(0.05)
        assert emulator.stage.applied_force == [0.0, 0.0]
        control.process.send_signal(signal.SIGCONT)
        time.sleep(0.05)
        control.process.kill()
    control.process.wait(PATIENCE_S)
    wait_for_zero(emulator)


@pytest.mark.requirement(id="SR-6.2")
@pytest.mark.slow
@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_at_random_moments_any_end_leaves_the_drives_at_zero(chunk: int) -> None:
    moments = random.Random(chunk)
    with emulated(WATCHDOG) as emulator:
        for number in range(-(-MOMENTS // CHUNKS)):
            how = (signal.SIGKILL, signal.SIGSTOP, signal.SIGTERM)[number % 3]
            operator = EagerOperator()
            with Control() as control:
                operator.start()
                time.sleep(moments.uniform(0.0, LATEST_S))
                operator.ended.set()
                operator.join()
                end_it(control, how, emulator)
            check_trips(emulator)
            assert emulator.stage.applied_force == [0.0, 0.0]


def test_a_restart_after_a_kill_waits_for_the_operator_with_the_drives_latched() -> None:
    with emulated(PATIENT) as emulator:
        with Control() as control:
            reader = control.wait_for(State.READY)
            order(CommandKind.ACTIVATE)
            control.wait_for(State.ACTIVE, reader)
            end_it(control, signal.SIGKILL, emulator)
        wait_for_trips(emulator)
        check_trips(emulator)
        with Control() as second:
            reader = second.wait_for(State.CONNECTED)
            time.sleep(0.3)
            records = reader.read(100_000).records
            # The drives' latched watchdogs keep it from READY; FAULT is a machine that held the stage up meanwhile.
            assert {State(int(value)) for value in records["state"]} <= {State.CONNECTED, State.FAULT}
            assert {Fault(int(value)).name for value in records["fault"]} <= {Fault.NONE.name, *STALL_FAULTS}
            order(CommandKind.RESET)
            second.wait_for(State.READY, reader)


WEDGED = """
import hil.cycle.step
step = hil.cycle.step.ControlCycle.step
def wedging(self, tick, frames):
    while self.state.name == "ACTIVE" and tick.index > 100:
        pass
    return step(self, tick, frames)
hil.cycle.step.ControlCycle.step = wedging
"""


@pytest.mark.requirement(id="SR-6.2")
@pytest.mark.replaces_methods
def test_a_wedged_loop_is_a_silent_one_and_the_drives_go_to_zero() -> None:
    with emulated(PATIENT) as emulator, Control(wrap=WEDGED) as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.ACTIVE, reader)
        wait_for_trips(emulator)
        assert emulator.stage.applied_force == [0.0, 0.0]
        check_trips(emulator)


def full_tmpfs(folder: Path) -> bool:
    folder.mkdir(mode=0o700)
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k,mode=700", "tmpfs", str(folder)], capture_output=True, check=False
    )
    return mounted.returncode == 0


def test_a_full_runtime_folder_is_refused_before_any_torque(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "full"
    if not full_tmpfs(folder):
        pytest.skip("needs root: only root may mount the small tmpfs that is to be full")
    try:
        monkeypatch.setenv("HIL_RUNTIME_DIR", str(folder))
        with Control() as control:
            status, _, err = control.finish()
        assert status != 0
        assert "Traceback" not in err
        assert str(folder) in err or "space" in err
    finally:
        subprocess.run(["umount", str(folder)], check=True)
