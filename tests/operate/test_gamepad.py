"""`hil jog RIG --gamepad`: events as the kernel writes them, from a pipe; a stick moves while a shoulder is held."""

import os
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.cycle.goal import MotionWord
from hil.cycle.state_machine import State
from hil.operate.gamepad import (
    EAST,
    HAT_Y,
    LEFT_X,
    LEFT_Y,
    RIGHT_X,
    RIGHT_Y,
    SHOULDER_LEFT,
    SHOULDER_RIGHT,
    SOUTH,
    START,
    Gamepad,
    GamepadGoneError,
    Range,
)
from hil.operate.jog_gamepad import GAINED, LOST, SPEEDS, VALID_S, PadJog, by_gamepad

KEY, ABS, SYN, DROPPED = 1, 3, 0, 3
END = 32767


def event(kind: int, code: int, value: int) -> bytes:
    """One struct input_event of linux/input.h."""
    return struct.pack("@llHHi", 1764201600, 500, kind, code, value)


def report(*events: tuple[int, int, int]) -> bytes:
    """Events and the report that ends them."""
    return b"".join(event(*one) for one in events) + event(SYN, 0, 0)


class Bench:
    """A rig in virtual time, and a gamepad whose kernel is a pipe."""

    def __init__(self, mover: hil.VirtualMover) -> None:
        reader, self._writer = os.pipe()
        os.set_blocking(reader, False)
        self.mover, self.pad = mover, Gamepad(reader)
        self.jog = PadJog(mover, self.pad, lambda: setattr(mover._simulated.run, "estop", True))

    def write(self, *events: tuple[int, int, int]) -> None:
        os.write(self._writer, report(*events))

    def turn(self, *events: tuple[int, int, int], typed: str = "", seconds: float = 0.05) -> bool:
        """A round of the loop, and that time after it."""
        if events:
            self.write(*events)
        goes_on = self.jog.turn(self.pad.read(), typed)
        self.mover.sleep(seconds)
        return goes_on

    def unplug(self) -> None:
        os.close(self._writer)


@pytest.fixture
def bench() -> Iterator[Bench]:
    mover = hil.motion(hil.load_rig("microscope-ideal"))
    assert isinstance(mover, hil.VirtualMover)
    with mover:
        bench = Bench(mover)
        yield bench
        bench.pad.close()


def test_a_stick_is_a_speed_while_a_shoulder_button_is_held(bench: Bench) -> None:
    bench.turn((ABS, LEFT_X, END))
    assert bench.mover.status().number == 0  # nobody holds the button
    bench.turn((KEY, SHOULDER_RIGHT, 1))
    for _ in range(5):
        bench.turn()  # a stick that is held still tells nothing, and goes on
    look = bench.mover.status()
    assert look.motion is MotionWord.JOG
    assert look.velocity == pytest.approx([bench.jog.speed, 0.0, 0.0, 0.0])
    assert bench.jog.speed == 1e-3


@pytest.mark.parametrize(
    "ends",
    [
        [(ABS, LEFT_X, 500)],  # the stick is centred
        [(KEY, SHOULDER_LEFT, 0)],
        [(SYN, DROPPED, 0)],  # nobody knows what was let go
    ],
)
def test_what_is_let_go_ends_the_jog_within_its_validity(bench: Bench, ends: list[tuple[int, int, int]]) -> None:
    bench.turn((KEY, SHOULDER_LEFT, 1), (ABS, LEFT_X, -END))
    bench.turn(*ends, seconds=0.0)
    number = bench.mover.status().number
    bench.turn(seconds=VALID_S + 0.1)
    look = bench.mover.status()
    assert (look.motion, look.number) == (MotionWord.HOLD, number)
    assert look.setpoint[0] < 0.0


def test_a_device_that_is_gone_and_a_lost_focus_end_it_too(bench: Bench) -> None:
    held = (KEY, SHOULDER_LEFT, 1)
    bench.turn(held, (ABS, LEFT_X, END))
    bench.turn(typed=LOST, seconds=VALID_S + 0.1)
    assert bench.mover.status().motion is MotionWord.HOLD
    assert "lacks the focus" in bench.jog.line()
    bench.turn(typed=GAINED)
    assert bench.mover.status().motion is MotionWord.JOG
    bench.unplug()
    with pytest.raises(GamepadGoneError, match="the gamepad is gone"):
        bench.pad.read()
    assert not bench.pad.holds([SHOULDER_LEFT])
    bench.jog.turn([])
    bench.mover.sleep(VALID_S + 0.1)
    assert bench.mover.status().motion is MotionWord.HOLD


def test_each_stick_leads_its_axis_and_up_is_positive(bench: Bench) -> None:
    sticks = ((LEFT_X, END), (LEFT_Y, -END - 1), (RIGHT_Y, -END - 1), (RIGHT_X, END))
    bench.turn((KEY, SHOULDER_LEFT, 1), *((ABS, code, value) for code, value in sticks), seconds=0.1)
    assert bench.mover.status().velocity == pytest.approx([1e-3, 1e-3, 1e-3, 1e-2])


def test_the_cross_changes_the_speed_and_no_speed_is_above_the_axis_limit(bench: Bench) -> None:
    bench.turn((ABS, HAT_Y, -1), (ABS, HAT_Y, 0))
    assert bench.jog.speed == 2e-3
    bench.turn((ABS, HAT_Y, 1), (ABS, HAT_Y, 0), (ABS, HAT_Y, 1), (ABS, HAT_Y, 0))
    assert bench.jog.speed == 5e-4
    for _ in range(20):
        bench.turn((ABS, HAT_Y, -1), (ABS, HAT_Y, 0), seconds=0.0)
    assert bench.jog.speed == SPEEDS[-1]
    bench.turn((KEY, SHOULDER_LEFT, 1), (ABS, RIGHT_Y, -END - 1), seconds=0.12)
    assert bench.mover.status().velocity[2] <= bench.mover.most_speed("z")
    assert bench.jog.said == ""


def test_buttons_halt_stop_and_leave(bench: Bench) -> None:
    bench.turn((KEY, SHOULDER_LEFT, 1), (ABS, LEFT_X, END))
    bench.turn((KEY, SOUTH, 1), (KEY, SHOULDER_LEFT, 0), seconds=0.1)
    assert bench.mover.status().motion is MotionWord.HOLD
    assert not bench.turn((KEY, START, 1))
    assert not bench.turn(typed="q")
    bench.turn((KEY, EAST, 1))
    assert bench.mover.status().state is State.ESTOP


def test_a_stick_counts_from_its_own_middle_and_rises_from_nothing_behind_the_dead_zone() -> None:
    byte = Range(0, 255, 15)
    assert [byte.part(value) for value in (0, 255, 127, 128, 142, 113)] == [-1.0, 1.0, 0.0, 0.0, 0.0, 0.0]
    assert 0.0 < byte.part(144) < 0.02
    assert Range().part(20000) == pytest.approx((20000.5 / 32767.5 - 0.12) / 0.88)


@given(st.lists(st.binary(max_size=60), max_size=8))
def test_events_are_whole_however_they_are_cut_and_nonsense_moves_nothing_by_itself(parts: list[bytes]) -> None:
    reader, writer = os.pipe()
    os.close(writer)
    with Gamepad(reader) as pad:
        for part in parts:
            pad.take(part)
        assert all(-1.0 <= pad.stick(code) <= 1.0 for code in (LEFT_X, LEFT_Y, RIGHT_X, RIGHT_Y))
        pad.let_go()
        assert [pad.stick(code) for code in (LEFT_X, LEFT_Y, RIGHT_X, RIGHT_Y)] == [0.0] * 4


def test_an_event_that_comes_in_two_reads_counts_once() -> None:
    reader, writer = os.pipe()
    os.close(writer)
    data = report((KEY, SOUTH, 1))
    with Gamepad(reader) as pad:
        assert [pad.take(data[:7]), pad.take(data[7:])] == [[], [SOUTH]]


def test_the_loop_reads_a_device_file_until_start_is_pressed(
    bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    device = tmp_path / "event0"
    os.mkfifo(device)
    writer = os.open(device, os.O_RDWR)
    os.write(writer, report((KEY, SHOULDER_LEFT, 1), (ABS, LEFT_X, END), (KEY, START, 1)))
    with open(os.devnull) as nothing:
        monkeypatch.setattr("sys.stdin", nothing)
        by_gamepad(bench.mover, "microscope-ideal", str(device))
    os.close(writer)
    assert "hold a shoulder button" in capsys.readouterr().out


def test_where_there_is_none_it_is_said_how_to_name_one(bench: Bench, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"event5: No such file or directory; its readers are root and the group"):
        by_gamepad(bench.mover, "microscope-ideal", str(tmp_path / "event5"))
