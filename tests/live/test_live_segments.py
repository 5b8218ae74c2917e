"""A live rig on two segments of the local bus: it runs, and a segment that is left alone stops it."""

import signal
import subprocess
import sys
import time

import pytest

from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from tests.support.live_rig import CALM, PAPER, PATIENCE_S, Control, Emulator, emulated, every_record, order
from tests.support.two_segments import TWO

pytestmark = pytest.mark.live
SETS = (*TWO, "bus.interface=local")
WORDS = [word for override in SETS for word in ("--set", override)]


def cut(emulator: Emulator, axis: int) -> None:
    """What the axis' drive sends reaches nobody any more."""
    emulator.stage.frame_taps.append(lambda sender, frame: [] if sender == axis else [frame])


def test_a_task_runs_and_ends_with_zero_torque_on_both() -> None:
    with emulated(SETS) as emulator, Control(*WORDS) as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.ACTIVE, reader)
        time.sleep(0.2)
        control.process.send_signal(signal.SIGTERM)
        status, out, _ = control.finish()
        assert (status, "on can0, can1;" in out) == (0, True)
        assert emulator.stage.applied_force == [0.0, 0.0]
    active = [record for record in every_record() if record["state"] == State.ACTIVE]
    sent = {int(frame["flags"]) >> 4 & 3 for record in active for frame in record["sent"][: record["n_sent"]]}
    heard = {
        (int(frame["can_id"]), int(frame["flags"]) >> 4 & 3)
        for record in active
        for frame in record["received"][: record["n_received"]]
    }
    assert (sent, heard) == ({0, 1}, {(0x100, 0), (0x101, 1)})


def test_a_silent_segment_stops_both_axes() -> None:
    with emulated(SETS) as emulator, Control(*WORDS) as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE)
        control.wait_for(State.ACTIVE, reader)
        cut(emulator, 1)
        control.wait_for(State.FAULT, reader)
        control.process.send_signal(signal.SIGTERM)
        assert control.finish()[0] == 0
        assert emulator.stage.applied_force == [0.0, 0.0]
    last = every_record()[-1]
    assert Fault(int(last["fault"])) in (Fault.ENCODER_LOST, Fault.ENCODER_DEAD)


def test_hil_drives_surveys_one_segment_after_the_other() -> None:
    words = [word for override in (*CALM, *SETS) for word in ("--set", override)]
    with emulated(SETS):
        done = subprocess.run(
            [sys.executable, "-m", "hil", "drives", str(PAPER), *words],
            capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    places = [done.stdout.index(text) for text in ("can0: x", "can1: y")]
    assert places == sorted(places)
    assert done.stdout.count("ready") == 2
