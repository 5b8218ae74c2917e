"""`hil.motion` in virtual time: what a program asks for, what comes of it, and what it is told. All of it exact."""

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest

import hil
from hil.cycle.goal import MotionWord, Refusal
from hil.cycle.limits import motion_limits
from hil.cycle.state_machine import State

RIG = hil.load_rig("microscope-ideal")


def moved(*changes: str) -> hil.VirtualMover:
    mover = hil.motion(RIG.changed(*changes))
    assert isinstance(mover, hil.VirtualMover)
    return mover


def test_a_move_ends_on_its_target_and_the_next_is_counted_from_there() -> None:
    with moved() as m:
        assert m.move_to(x=1e-3, y=-5e-4, speed=0.5).wait().setpoint == [1e-3, -5e-4, 0.0, 0.0]
        assert m.move_by(x=-1e-3).wait().setpoint == [0.0, -5e-4, 0.0, 0.0]
        look = m.status()
    assert (look.state, look.motion) == (State.ACTIVE, MotionWord.HOLD)
    error = m.run().error
    assert np.nanmax(np.abs(error)) < 1e-4


def test_the_same_program_sends_the_same_bytes() -> None:
    def program() -> str:
        with moved() as m:
            m.move_to(x=1e-3)
            m.sleep(0.01)
            m.jog(y=2e-3)
            m.wait()
            return m.trace_sha256

    assert program() == program()


def test_leaving_stops_what_was_begun_and_goes_on_holding() -> None:
    with moved() as m:
        m.move_to(x=1e-2, speed=0.1)
        m.sleep(0.1)
        assert m.status().motion is MotionWord.MOVE
    look = m.wait(1.0)
    assert 0.0 < look.setpoint[0] < 9e-3
    assert look.state is State.ACTIVE


def test_an_exception_in_the_program_stops_the_axes_too() -> None:
    m = moved()

    def interrupted() -> None:
        with m:
            m.move_to(x=1e-2, speed=0.1)
            m.sleep(0.1)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert m.wait(1.0).setpoint[0] < 9e-3


def test_a_jog_that_is_not_repeated_ends_by_itself() -> None:
    with moved() as m:
        m.jog(x=5e-3, seconds=0.1)
        m.sleep(0.05)
        assert m.status().velocity[0] == pytest.approx(5e-3)
        look = m.wait(1.0)
    assert 4e-4 < look.setpoint[0] < 6e-4


def test_a_stream_goes_through_its_points_and_rests_behind_the_last() -> None:
    with moved() as m:
        for step in range(1, 21):
            m.send({"x": 1e-5 * step}, {"x": 1e-3}, due=0.02)
            m.sleep(0.01)
        assert m.status().motion is MotionWord.STREAM
        look = m.wait(1.0)
    run = m.run()
    assert look.setpoint[0] > 2e-4
    assert np.nanmax(np.abs(np.diff(run.columns["setpoint_velocity"][:, 0]))) < 1e-3


def test_a_task_is_played_paused_and_resumed() -> None:
    with moved() as m:
        m.play()
        m.sleep(0.3)
        m.pause()
        m.sleep(0.3)
        paused = m.status()
        m.sleep(0.3)
        assert paused.motion is MotionWord.PAUSED
        assert m.status().setpoint == paused.setpoint
        m.resume()
        m.sleep(0.3)
        assert m.status().motion is MotionWord.PATH
        assert m.status().setpoint != paused.setpoint
        m.halt().wait(5.0)


SQUARE = {"x": [0.0, 1e-3, 1e-3, 0.0], "y": [0.0, 0.0, 1e-3, 1e-3]}


def test_a_path_begins_at_its_first_point_and_ends_at_its_last() -> None:
    with moved() as m:
        m.move_to(x=-2e-3, z=1e-3).wait()
        path = m.path(SQUARE, speed=0.02, blend=1e-5)
        assert m.status().setpoint == [0.0, 0.0, 1e-3, 0.0]
        m.sleep(0.05)
        assert m.status().motion is MotionWord.PATH
        assert path.wait().setpoint == [0.0, 1e-3, 1e-3, 0.0]
    run = m.run()
    followed = run.columns["setpoint_position"][run.columns["motion"] == MotionWord.PATH]
    x, y = followed[:, 0], followed[:, 1]
    beside = [np.maximum(np.abs(y), np.maximum(x - 1e-3, -x)), np.abs(x - 1e-3), np.abs(y - 1e-3)]
    assert np.min(beside, axis=0).max() <= 1e-5
    assert np.nanmax(np.abs(run.columns["setpoint_velocity"][:, :2])) <= 0.064
    assert np.abs(np.diff(followed, axis=0)).max() <= 0.02 * 1e-3 * (1.0 + 1e-9)


def test_paths_follow_each_other_and_one_that_repeats_goes_on_until_it_is_halted() -> None:
    with moved() as m:
        assert m.path(SQUARE).wait().setpoint[:2] == [0.0, 1e-3]
        back = {name: values[::-1] for name, values in SQUARE.items()}
        m.path(back, blend=2e-5, repeat=True)
        m.sleep(1.0)
        m.pause()
        m.sleep(0.2)
        assert m.status().motion is MotionWord.PAUSED
        m.resume()
        m.sleep(0.2)
        assert m.status().motion is MotionWord.PATH
        assert m.halt().wait(1.0).state is State.ACTIVE


def test_timed_rows_are_passed_in_time_and_come_to_rest_behind_the_last() -> None:
    rate, lead, turn = 30, 2 / 30, 2.0 * math.pi
    rows = [
        (k / rate, {"x": 1e-3 * math.cos(turn * k / rate), "y": 1e-3 * math.sin(turn * k / rate)}) for k in range(61)
    ]
    with moved() as m:
        assert m.stream(rows, lead=lead)[:2] == (61, 0)
        ended = m.now_ns()
        m.wait()
        assert m.now_ns() - ended < (lead + 0.1) * 1e9
    run = m.run()
    off = np.hypot(*run.columns["setpoint_position"][-1, :2] - [1e-3, 0.0])
    assert off < 1e-12
    passing = run.columns["motion"] == MotionWord.STREAM
    radius = np.hypot(*run.columns["setpoint_position"][passing, :2].T)
    assert np.abs(radius - 1e-3).max() < 2e-5, "at both ends the speed is 0"
    assert np.abs(radius[200:-200] - 1e-3).max() < 1e-6


def test_a_row_that_comes_too_late_is_left_out() -> None:
    def rows() -> Iterator[tuple[float, dict[str, float]]]:
        for k in range(20):
            if k == 10:
                m.sleep(0.2)  # whoever makes the rows was held up
            yield 0.02 * k, {"x": 1e-5 * k}

    with moved() as m:
        sent, late, _ = m.stream(rows())
        look = m.wait()
    assert (sent + late, look.setpoint[0]) == (20, pytest.approx(1.9e-4, abs=1e-12))
    assert 6 <= late <= 8


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([(0.0, {"x": 0.0}), (0.0, {"x": 1e-4})], "row 2: not later than the row before"),
        ([(0.0, {"x": 0.0}), (0.1, {"y": 1e-4})], "row 2: .* or of other axes"),
        ([(0.0, {"w": 0.0})], "no axis 'w'"),
    ],
)
def test_rows_that_are_no_stream_are_told(rows: list[tuple[float, dict[str, float]]], words: str) -> None:
    with moved() as m, pytest.raises(ValueError, match=words):
        m.stream(rows)


def test_a_move_that_another_goal_cuts_short_says_where_it_rests() -> None:
    with moved() as m:
        move = m.move_to(x=1e-2, speed=0.1)
        m.sleep(0.1)
        move.cancel()
        with pytest.raises(hil.MotionError, match=r"x rests at 0\.00\d+, not at 0\.01: cut short"):
            move.wait()


def test_a_rig_that_stopped_on_the_way_is_told() -> None:
    with moved() as m:
        move = m.move_to(x=1e-2, speed=0.1)
        m.sleep(0.1)
        m._simulated.run.estop = True
        m.sleep(0.001)
        with pytest.raises(hil.MotionError, match="left ACTIVE on the way: it is ESTOP"):
            move.wait()
        with pytest.raises(hil.GoalRefusedError, match="move: the rig is ESTOP; goals are taken in ACTIVE") as refused:
            m.move_to(x=0.0)
        assert refused.value.refusal is Refusal.NOT_ACTIVE


def test_a_move_is_over_once_the_axes_have_been_in_position_for_twenty_milliseconds() -> None:
    with moved("axes.x.motion.window=2e-7") as m:
        move = m.move_to(x=1e-4)
        while m.status().motion is not MotionWord.HOLD:
            assert not m.status().in_position
            m.sleep(0.001)
        look = move.wait()
    run = m.run()
    last = slice(-20, None)
    assert look.in_position
    assert (run.columns["motion"][last] == MotionWord.HOLD).all()
    assert np.abs(run.error[last, 0]).max() <= 2e-7


@pytest.mark.long
def test_an_axis_that_stays_beside_its_set_point_is_told_with_its_window() -> None:
    stuck = r"^not in position 5 s after the set-points came to rest: x is .* beyond axes\.x\.motion\.window = 1e-12"
    with moved("axes.x.motion.window=1e-12") as m, pytest.raises(hil.MotionError, match=stuck):
        m.move_to(x=1e-4).wait()


def test_goals_are_no_task_whose_approach_the_figures_leave_out() -> None:
    with moved() as m:
        m.move_to(x=1e-4).wait()
    assert m.run().summary()["steady_from_s"] == 0.0


def test_waiting_has_an_end() -> None:
    with moved() as m:
        move = m.move_to(x=1e-2, speed=0.01)
        with pytest.raises(TimeoutError, match=r"has not come to rest within 0\.05 s"):
            move.wait(0.05)


LIMITS = motion_limits(RIG.config)[0]
RANGE = f"{LIMITS.low:.6g} to {LIMITS.high:.6g}"


@pytest.mark.parametrize(
    ("ask", "error", "words"),
    [
        (lambda m: m.move_to(x=1.0), hil.GoalRefusedError, rf"x = 1: from {RANGE} \(axes"),
        (lambda m: m.move_by(x=1.0), hil.GoalRefusedError, rf"beyond the travel .*: x {RANGE}"),
        (lambda m: m.jog(x=1.0), hil.GoalRefusedError, rf"x = 1: at most {LIMITS.speed:g} \(axes\.x\.motion\.speed\)"),
        (lambda m: m.pause(), hil.GoalRefusedError, "rate: no path to begin or to pause here"),
        (lambda m: m.move_to(w=1.0), ValueError, "no axis 'w': the rig has x, y, z, theta"),
        (lambda m: m.move_to(), ValueError, "no axis: name at least one of x, y, z, theta"),
        (lambda m: m.move_to(x=float("nan")), ValueError, "x = nan: not a finite number"),
        (lambda m: m.move_to(x=0.0, speed=1.5), ValueError, r"speed = 1\.5: from 0\.001 to 1"),
        (lambda m: m.jog(x=1e-3, seconds=0.6), ValueError, r"seconds = 0\.6: from 0\.001 to 0\.5"),
        (lambda m: m.send({"x": 0.0}, {"y": 0.0}, due=0.1), ValueError, "velocity: of the axes x, got y"),
        (lambda m: m.send({"x": 0.0}, due=-1.0), ValueError, "due = -1: from 0 to 10"),
        (lambda m: m.path({"x": [0.0, 1e-3], "y": [0.0]}), ValueError, "as many for each axis, at least two; got"),
        (lambda m: m.path({}), ValueError, "points: as many for each axis"),
        (lambda m: m.path({"x": [0.0, 1e-3]}, speed=9.0), hil.GoalRefusedError, r"speed = 9: .* \(axes\.x\.motion"),
        (lambda m: m.path({"x": [0.0, 9.0]}), hil.RigError, "row 2, column x: 9 is outside axes.x.limits.position"),
        (lambda m: m.path({"x": [0.0, float("nan")]}), hil.RigError, r"task\.waypoints\.1\.0 = nan"),
        (lambda m: m.stream([(0.0, {"x": 0.0})], lead=0.0), ValueError, r"lead = 0: from 0\.001 to 10"),
        (lambda m: m.rate(1.3), ValueError, r"rate = 1\.3: from 0 to 1\.2"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_with_key_value_and_range(
    ask: Callable[[hil.Mover], object], error: type[Exception], words: str
) -> None:
    with moved() as m:
        before = m.status().number
        with pytest.raises(error, match=words):
            ask(m)
        assert m.status().number == before
        assert m.status().motion is MotionWord.HOLD
