"""`hil jog RIG` by keys: a press is a step, a key held down a jog that ends when it is let go. In virtual time."""

import os
import sys
from collections.abc import Iterator

import pytest

import hil
from hil.cycle.goal import MotionWord
from hil.cycle.state_machine import State
from hil.operate import jog_keys
from hil.operate.jog_keys import STEPS, KeyJog, by_keys

LEFT, RIGHT, UP, PAGE_DOWN = "\x1b[D", "\x1b[C", "\x1b[A", "\x1b[6~"


@pytest.fixture
def mover() -> Iterator[hil.VirtualMover]:
    made = hil.motion(hil.load_rig("microscope"))
    assert isinstance(made, hil.VirtualMover)
    with made:
        yield made


@pytest.fixture
def jog(mover: hil.VirtualMover) -> KeyJog:
    return KeyJog(mover, lambda: setattr(mover._simulated.run, "estop", True))


def press(jog: KeyJog, mover: hil.VirtualMover, text: str, seconds: float = 0.5) -> bool:
    """A press, and that time after it."""
    goes_on = jog.press(text, mover.now_ns() * 1e-9)
    mover.sleep(seconds)
    return goes_on


@pytest.mark.long
def test_a_press_is_a_step_of_its_axis(jog: KeyJog, mover: hil.VirtualMover) -> None:
    begun = mover.status().setpoint
    for text, steps in (
        (RIGHT, [1e-5, 0.0, 0.0, 0.0]),
        (RIGHT, [2e-5, 0.0, 0.0, 0.0]),
        (UP, [2e-5, 1e-5, 0.0, 0.0]),
        (PAGE_DOWN, [2e-5, 1e-5, -1e-5, 0.0]),
        ("]", [2e-5, 1e-5, -1e-5, 1e-4]),
        (LEFT + LEFT, [1e-5, 1e-5, -1e-5, 1e-4]),  # read at once, it is one
    ):
        assert press(jog, mover, text)
        assert mover.status().motion is MotionWord.HOLD
        gone = [now - then for now, then in zip(mover.status().setpoint, begun, strict=True)]
        assert gone == pytest.approx(steps, abs=1e-12)
    look = mover.status()
    line = jog.line(look)
    assert f"x {look.position[0] * 1e3:+.4f} mm" in line
    assert f"theta {look.position[3] * 1e3:+.4f} mrad  step 10 um" in line


def test_a_key_held_down_is_a_jog_that_ends_when_it_is_let_go(jog: KeyJog, mover: hil.VirtualMover) -> None:
    press(jog, mover, RIGHT, 0.3)
    for _ in range(30):  # as terminals repeat a key
        press(jog, mover, RIGHT, 0.033)
    assert mover.status().motion is MotionWord.JOG
    assert mover.status().velocity[0] == pytest.approx(20.0 * 1e-5)
    let_go = mover.status().setpoint[0]
    mover.sleep(0.3)
    look = mover.status()
    assert look.motion is MotionWord.HOLD
    assert look.setpoint[0] < let_go + 20.0 * 1e-5 * 0.2


def test_the_step_is_set_within_bounds_and_a_jog_is_no_faster_than_goals_may_be(
    jog: KeyJog, mover: hil.VirtualMover
) -> None:
    for key, end in (("-", STEPS[0]), ("+", STEPS[-1])):
        for _ in range(len(STEPS) + 3):
            press(jog, mover, key, 0.001)
        assert jog.step == end
    for _ in range(10):
        press(jog, mover, RIGHT, 0.033)
    assert jog.said == ""
    assert 0.0 < mover.status().velocity[0] <= mover.most_speed("x")


@pytest.mark.long
def test_at_the_end_of_the_travel_it_says_why_it_stays(jog: KeyJog, mover: hil.VirtualMover) -> None:
    for _ in range(len(STEPS)):
        press(jog, mover, "+", 0.001)
    for _ in range(8):
        press(jog, mover, RIGHT, 0.5)
    assert "the target is beyond the travel less its margin: x" in jog.said
    assert jog.said in jog.line(mover.status())
    press(jog, mover, LEFT)
    assert jog.said == ""


def test_space_halts_e_stops_and_q_leaves(jog: KeyJog, mover: hil.VirtualMover) -> None:
    mover.move_to(x=1e-2, speed=0.1)
    press(jog, mover, " ")
    assert mover.status().motion is MotionWord.HOLD
    assert mover.status().setpoint[0] < 1e-2
    assert press(jog, mover, "\x1b[15~x?\x00")
    assert not press(jog, mover, "q")
    assert press(jog, mover, "e")
    assert mover.status().state is State.ESTOP
    press(jog, mover, RIGHT)
    assert "the rig is ESTOP" in jog.said


def test_in_a_terminal_until_q_and_without_one_it_says_what_it_needs(
    mover: hil.VirtualMover, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(jog_keys, "POLL_S", 0.001)
    ours, theirs = os.openpty()
    with open(theirs) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        os.write(ours, f"{RIGHT}q".encode())
        by_keys(mover, "microscope")
        monkeypatch.undo()
    assert mover.wait(2.0).setpoint[0] == pytest.approx(1e-5, abs=1e-6)
    assert capsys.readouterr().out.startswith("x left right, y down up, z PgDn PgUp, theta [ ]; hold a key to go on")
    os.close(ours)
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        with pytest.raises(ValueError, match="needs a terminal"):
            by_keys(mover, "microscope")
