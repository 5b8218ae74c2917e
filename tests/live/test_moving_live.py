"""A running rig is moved through its goal page: by one client at a time, whose end it outlives."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest

import hil
from hil.cycle.goal import MotionWord
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.ring import RingReader
from hil.live.runtime_paths import runtime_paths
from tests.support.live_rig import HEAVY, PATIENCE_S, Control, emulated, every_record, order

pytestmark = pytest.mark.live
HIL = [sys.executable, "-m", "hil"]


@pytest.fixture
def held() -> Iterator[Control]:
    """A rig that holds, for goals."""
    with emulated(HEAVY), Control(*[word for text in HEAVY for word in ("--set", text)]) as control:
        reader = control.wait_for(State.READY)
        order(CommandKind.ACTIVATE_HOLD)
        control.wait_for(State.ACTIVE, reader)
        yield control
        assert control.process.poll() is None
        order(CommandKind.STOP)
        control.wait_for(State.READY, reader)


def wait_for_word(word: MotionWord) -> None:
    until = time.monotonic() + PATIENCE_S
    with RingReader(runtime_paths("paper").ring) as reader:
        while reader.look(reader.written - 1, 1, ("motion",)).records["motion"].tolist() != [word]:
            assert time.monotonic() < until
            time.sleep(0.005)


def moved_as_soon_as_free() -> hil.Mover:
    until = time.monotonic() + PATIENCE_S
    while True:
        try:
            return hil.motion("paper", activate=False)
        except hil.MotionError:
            if time.monotonic() > until:
                raise
            time.sleep(0.05)


def test_a_script_moves_a_running_rig_and_leaves_it_holding(held: Control) -> None:
    with hil.motion("paper", activate=False) as m:
        look = m.move_to(x=1e-3, y=-5e-4).wait(PATIENCE_S)
        assert look.setpoint == [1e-3, -5e-4]
        with pytest.raises(hil.GoalRefusedError, match=r"x = 9: from .* to .* \(axes\.x\.limits\.position"):
            m.move_to(x=9.0)
        with pytest.raises(hil.GoalRefusedError, match="beyond the travel"):
            m.move_by(x=9.0)
        with pytest.raises(hil.MotionError, match=f"process {os.getpid()} of user"):
            hil.motion("paper", activate=False)
        m.move_by(x=0.2, speed=0.01)
    wait_for_word(MotionWord.HOLD)
    records = every_record()
    assert records["state"][-1] == State.ACTIVE
    assert 1e-3 < records["setpoint_position"][-1][0] < 0.2, "leaving stops what was begun"
    assert np.all(np.diff(records["index"]) >= 1)


def test_a_client_that_is_killed_leaves_the_axes_at_rest_and_the_lease_to_others(held: Control) -> None:
    code = (
        "import hil\nm = hil.motion('paper', activate=False)\nprint('up', flush=True)\n"
        "while True:\n    m.jog(x=1e-3)\n    m.sleep(0.02)"
    )
    client = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert client.stdout is not None
    assert client.stdout.readline() == "up\n"
    wait_for_word(MotionWord.JOG)
    client.send_signal(signal.SIGKILL)
    client.wait(PATIENCE_S)
    client.stdout.close()
    wait_for_word(MotionWord.HOLD)
    with moved_as_soon_as_free() as mover:
        mover.move_to(x=0.0).wait(PATIENCE_S)


def test_a_stop_ends_the_lease_and_what_comes_after_it_is_refused(held: Control) -> None:
    mover = hil.motion("paper", activate=False)
    mover.move_to(x=0.2, speed=0.01)
    order(CommandKind.STOP)
    held.wait_for(State.READY)
    with pytest.raises(hil.MotionError, match=r"lease has ended|is READY"):
        mover.move_to(x=2e-3)
    mover.close()
    with pytest.raises(hil.MotionError, match="`hil command paper activate-hold`"):
        hil.motion("paper", activate=False)


def test_the_command_line_moves_and_jogs(held: Control) -> None:
    done = subprocess.run([*HIL, "move", "paper", "x=1mm", "y=-20um"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("in position: x ")
    assert every_record()["setpoint_position"][-1].tolist()[:2] == pytest.approx([1e-3, -2e-5], rel=1e-12)
    done = subprocess.run(
        [*HIL, "jog", "paper", "x=1mm/s", "--seconds", "0.2"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert every_record()["setpoint_position"][-1][0] > 1e-3
    rows = "time_s,x,y\n" + "".join(f"{0.02 * k:.2f},{1e-5 * k},0\n" for k in range(26))
    done = subprocess.run([*HIL, "stream", "paper"], input=rows, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert re.match(r"\d+ rows sent, \d+ left out as too late\nin position: x ", done.stdout)
    assert every_record()["setpoint_position"][-1].tolist()[:2] == pytest.approx([2.5e-4, 0.0], abs=1e-12)
    for text, words in (
        ("x,y\n", "expected time_s,AXIS"),
        ("time_s,x\n0,1kg\n", "row 1, column x: '1kg' is no finite"),
    ):
        done = subprocess.run([*HIL, "stream", "paper"], input=text, capture_output=True, text=True, check=False)
        assert done.returncode == 1
        assert words in done.stderr
    with hil.motion("paper", activate=False) as m, pytest.raises(hil.MotionError, match="a path goes by the sidecar"):
        m.path({"x": [0.0, 1e-3]})
    done = subprocess.run([*HIL, "move", "paper", "x=2kg"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, "hil move: x=2kg: expected a number with one of m, mm, um, nm\n")
