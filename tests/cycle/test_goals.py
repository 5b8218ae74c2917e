"""Goals in the pure cycle: what a running rig does with them, held by its setpoints, frames and record."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hil.analysis.feasibility import travel_margin
from hil.control.plans.axis_plan import MotionLimits
from hil.cycle.goal import LINE, RELATIVE, Goal, GoalKind, MotionWord, Refusal
from hil.cycle.limits import motion_limits
from hil.cycle.state_machine import State
from hil.rig.file import load_rig
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.replay import replay_run
from tests.support.held import MS, RIG, TASK, Held


def test_hold_stands_where_it_is_and_a_move_ends_on_its_target() -> None:
    held = Held()
    assert held.desk.word is MotionWord.HOLD
    start = held.setpoint
    held.ticks(100)
    assert held.setpoint == start
    assert held.ask(GoalKind.MOVE, 1e-3, -5e-4, mask=0b11) == 0
    assert held.records[-1]["motion"] == MotionWord.MOVE
    held.settle()
    assert held.setpoint[:2] == [1e-3, -5e-4]
    assert held.setpoint[2:] == start[2:]
    held.hold_limits()


def test_a_goal_acts_in_the_frame_of_the_tick_that_takes_it() -> None:
    """The same rig without it sends another force in that tick."""
    one, other = Held(), Held()
    one.ticks(10)
    other.ticks(9)
    other.ask(GoalKind.JOG, velocity=(0.01, 0.0, 0.0, 0.0), mask=1)
    assert one.records[-2]["force"].tolist() == other.records[-2]["force"].tolist()
    assert one.records[-1]["force"][0] != other.records[-1]["force"][0]


def test_a_new_target_on_the_way_is_taken_without_a_jump() -> None:
    held, draw = Held(), np.random.default_rng(2)
    for _ in range(40):
        target = draw.uniform(-2e-3, 2e-3, 4)
        flags = int(draw.choice([0, RELATIVE, LINE]))
        refusal = held.ask(GoalKind.MOVE, *target.tolist(), mask=int(draw.integers(1, 16)), flags=flags)
        assert refusal in (0, Refusal.FENCE)
        held.ticks(int(draw.integers(1, 60)))
    held.ask(GoalKind.HALT)
    held.settle()
    held.hold_limits()


@pytest.mark.long
def test_a_jog_ends_by_itself_and_stays_inside_the_fence() -> None:
    held = Held()
    for _ in range(400):
        held.ask(GoalKind.JOG, velocity=(1.0, 0.0, 0.0, 0.0), mask=1, valid_ns=100 * MS)
        held.ticks(20)
    held.settle()
    held.hold_limits()
    assert held.setpoint[0] == pytest.approx(motion_limits(held.rig)[0].high, abs=1e-6)


def test_a_stream_follows_its_path_and_rests_behind_its_last_knot() -> None:
    held = Held()
    x0 = held.setpoint[0]
    for k in range(200):
        t = 0.01 * (k + 2)
        ease = min(t / 0.5, 1.0)
        q = x0 + 5e-4 * ease * np.sin(2 * np.pi * t)
        v = 5e-4 * (2 * np.pi * ease * np.cos(2 * np.pi * t) + (np.sin(2 * np.pi * t) / 0.5 if t < 0.5 else 0.0))
        refusal = held.ask(GoalKind.KNOT, float(q), velocity=(float(v), 0.0, 0.0, 0.0), mask=1, due_ns=20 * MS)
        assert refusal == 0
        held.ticks(9)
        if k > 2:
            now = 0.01 * (k + 1)
            ease = min(now / 0.5, 1.0)
            assert held.setpoint[0] == pytest.approx(x0 + 5e-4 * ease * np.sin(2 * np.pi * now), abs=2e-5)
    held.settle(100)
    held.hold_limits()


def slow_stream(held: Held, count: int, interval: int = 100) -> list[float]:
    """Knots two intervals ahead, each `interval` ticks; the errors of the setpoint, m, from the third on."""
    x0, found = held.setpoint[0], []
    for k in range(count):
        t = 1e-3 * interval * (k + 2)
        q, v = x0 + 1e-3 * np.sin(np.pi * t) ** 4, 4e-3 * np.pi * np.sin(np.pi * t) ** 3 * np.cos(np.pi * t)
        assert held.ask(GoalKind.KNOT, q, velocity=(v, 0.0, 0.0, 0.0), mask=1, due_ns=2 * interval * MS) == 0
        for tick in range(interval):
            if tick:
                held.run.tick()
            now = 1e-3 * (interval * k + tick)
            found.append(held.setpoint[0] - x0 - 1e-3 * float(np.sin(np.pi * now)) ** 4)
    return found[3 * interval :]


def test_a_slow_stream_follows_its_path_between_the_knots() -> None:
    held = Held()
    errors = slow_stream(held, 12)
    held.settle(1_000)
    held.hold_limits()
    assert np.sqrt(np.mean(np.square(errors))) < 3e-6


@pytest.mark.parametrize("kind", [GoalKind.HALT, GoalKind.MOVE, GoalKind.JOG])
def test_knots_that_are_still_ahead_give_way_to_any_other_goal_at_once(kind: GoalKind) -> None:
    held = Held()
    slow_stream(held, 5)
    assert held.ask(kind, -1e-3, velocity=(-0.01, 0.0, 0.0, 0.0), mask=1) == 0
    before = held.setpoint[0]
    held.settle()
    held.hold_limits()
    assert abs(held.setpoint[0] - before) < 1e-4 if kind is GoalKind.HALT else held.setpoint[0] < before


@pytest.mark.parametrize("seed", range(3))
def test_any_stream_keeps_the_limits_and_ends_at_rest(seed: int) -> None:
    held, draw = Held(), np.random.default_rng(seed)
    limits, place = motion_limits(held.rig), 0.0
    for _ in range(60):
        kind = GoalKind.KNOT if draw.random() < 0.9 else GoalKind.HALT
        place += float(draw.normal(0.0, 2e-4))
        speed, due = float(draw.normal(0.0, 0.3 * limits[0].speed)), int(draw.choice([1, 5, 20, 60, 200]))
        held.ask(kind, place, velocity=(speed, 0.0, 0.0, 0.0), mask=1, due_ns=due * MS)
        held.ticks(int(draw.integers(0, 40)))
    held.settle()
    held.hold_limits()


def test_a_task_can_be_paused_on_its_way_and_goes_on() -> None:
    held = Held(*TASK, hold=False)
    assert held.desk.word is MotionWord.TASK
    held.ticks(1_000)
    assert held.ask(GoalKind.RATE, speed=0.0) == 0
    held.ticks(300)
    assert held.desk.word is MotionWord.PAUSED
    place = held.setpoint
    held.ticks(50)
    assert held.setpoint == place
    assert np.hypot(*place[:2]) == pytest.approx(1e-3, rel=1e-6)
    assert held.ask(GoalKind.RATE, speed=1.0) == 0
    held.ticks(400)
    assert held.desk.word is MotionWord.PATH
    assert held.setpoint != place
    assert np.hypot(*held.setpoint[:2]) == pytest.approx(1e-3, rel=1e-6)


def test_a_task_that_was_paused_goes_to_hold_where_it_ends() -> None:
    held = Held("task.kind=waypoints", "task.axes=['x']", "task.waypoints=[[0.0], [1e-3]]", "task.approach_s=0.1",
                hold=False)  # fmt: skip
    held.ticks(150)
    assert held.ask(GoalKind.RATE, speed=0.0) == 0
    held.ticks(300)
    assert held.desk.word is MotionWord.PAUSED
    assert held.ask(GoalKind.RATE, speed=1.0) == 0
    held.settle(3_000)
    held.ticks(10)
    assert held.setpoint[0] == 1e-3
    assert held.ask(GoalKind.MOVE, 0.0, mask=1) == 0
    held.settle()
    assert held.setpoint[0] == 0.0


def test_a_goal_stops_a_task_along_its_path_first() -> None:
    held = Held(*TASK, hold=False)
    held.ticks(1_000)
    assert held.ask(GoalKind.MOVE, 0.0, 0.0, mask=0b11) == 0
    held.settle()
    assert held.setpoint[:2] == [0.0, 0.0]
    found = np.array(held.accelerations)[:, :2]
    assert np.abs(np.diff(found, axis=0)).max() < 0.2 * np.abs(found).max() + 0.05


def test_a_task_may_forbid_it() -> None:
    held = Held(*TASK, "motion.interrupt=false", hold=False)
    held.ticks(100)
    assert held.ask(GoalKind.MOVE, 0.0, mask=1) == Refusal.TASK
    assert held.desk.word is MotionWord.TASK


def test_the_task_begins_from_hold_by_a_path() -> None:
    held = Held(*TASK)
    assert held.ask(GoalKind.PATH) == 0
    assert held.desk.word is MotionWord.PATH
    held.ticks(1_000)
    assert np.hypot(*held.setpoint[:2]) == pytest.approx(1e-3, rel=1e-6)


def test_a_task_that_is_over_goes_to_hold() -> None:
    held = Held("task.kind=waypoints", "task.axes=['x']", "task.waypoints=[[0.0], [1e-4]]", "task.approach_s=0.1",
                hold=False)  # fmt: skip
    assert held.desk.word is MotionWord.TASK
    held.settle()
    assert held.ask(GoalKind.MOVE, 0.0, mask=1) == 0
    held.settle()
    assert held.setpoint[0] == 0.0


def test_of_a_flood_the_newest_of_each_kind_count() -> None:
    held = Held()
    for number in range(50):
        held.run.goals.append(Goal(number + 1, GoalKind.MOVE, 1, position=(1e-5 * number, 0.0, 0.0, 0.0)))
    held.run.tick()
    record = held.records[-1]
    assert (record["n_goals"], record["superseded"], record["goal_number"]) == (1, 49, 50)
    held.settle()
    assert held.setpoint[0] == 1e-5 * 49


def test_goals_outside_active_are_refused() -> None:
    held = Held()
    held.run.goals.append(Goal(1, GoalKind.MOVE, 1, position=(1e-3, 0.0, 0.0, 0.0)))
    held.run.estop = True
    held.ticks(2)
    held.run.goals.append(Goal(2, GoalKind.MOVE, 1, position=(1e-3, 0.0, 0.0, 0.0)))
    held.ticks(1)
    assert int(held.records[-1]["goals"][0]["refusal"]) == Refusal.NOT_ACTIVE
    assert held.records[-1]["motion"] == MotionWord.NONE


def goals_of(seed: int) -> Iterator[Goal]:
    draw = np.random.default_rng(seed)
    number = 0
    while True:
        number += 1
        yield Goal(
            number, int(draw.integers(0, 8)), int(draw.integers(0, 17)), int(draw.integers(0, 4)),
            int(draw.integers(0, 50)) * MS, int(draw.integers(0, 550)) * MS,
            tuple(draw.uniform(-3e-3, 3e-3, 4).tolist()), tuple(draw.uniform(-0.02, 0.02, 4).tolist()),
            float(draw.uniform(0.0, 1.1)),
        )  # fmt: skip


def test_replay_needs_the_recording_alone(tmp_path: Path) -> None:
    """Any goals at all, several a tick: limits kept, no fault, and the same frames from the file."""
    rig = load_rig(RIG, TASK)
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, RIG)
    held, source = Held(*TASK, observer=recorder.observe), goals_of(7)
    draw = np.random.default_rng(1)
    for _ in range(1_500):
        held.run.goals += [next(source) for _ in range(int(draw.integers(0, 4)) // 2)]
        held.run.tick()
    recorder.close()
    assert held.run.cycle.state is State.ACTIVE
    report = replay_run(tmp_path / "run.mcap")
    assert (report.ticks, report.different) == (held.run.index, 0)


@pytest.mark.requirement(id="SR-4.1")
@pytest.mark.parametrize("seed", range(3))
def test_no_plan_ends_outside_the_fence(seed: int) -> None:
    """Whatever goal was taken last, every axis comes to rest inside the travel less its margin."""
    held, draw = Held(), np.random.default_rng(seed)
    limits = motion_limits(held.rig)
    for axis, li in zip(held.rig.axes.values(), limits, strict=True):
        margin = travel_margin(axis.limits)
        assert margin > 0
        assert (li.low, li.high) == (axis.limits.position[0] + margin, axis.limits.position[1] - margin)
    reach = [1.5 * (li.high - li.low) for li in limits]
    taken = 0
    for _ in range(60):
        kind = int(draw.choice([GoalKind.MOVE, GoalKind.JOG, GoalKind.KNOT, GoalKind.HALT]))
        places = [float(draw.uniform(-r, r)) for r in reach]
        speeds = tuple(float(draw.uniform(-2 * li.speed, 2 * li.speed)) for li in limits)
        mask = int(draw.integers(1, 16))
        taken += held.ask(kind, *places, velocity=speeds, mask=mask, valid_ns=200 * MS, due_ns=20 * MS) == 0
        held.ticks(int(draw.integers(1, 30)))
        course = held.desk._course
        for axis, li in enumerate(limits if course else ()):
            assert li.low - 1e-12 <= course.newest(axis).plan.target <= li.high + 1e-12
    assert taken > 20
    held.settle()
    held.hold_limits()


@pytest.mark.requirement(id="SR-4.6")
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_from_outside_the_fence_goals_lead_inward_at_a_fifth_of_the_speed(side: float) -> None:
    held = Held()
    desk, li = held.desk, motion_limits(held.rig)[0]
    x0 = held.setpoint[0]
    # The fence is drawn in behind the stage, as after a reset outside of it.
    fence = (x0 - 2e-3, x0 - 1e-3) if side > 0 else (x0 + 1e-3, x0 + 2e-3)
    desk._limits[0] = MotionLimits(li.speed, li.acceleration, li.jerk, *fence)
    begun = len(held.records)
    assert held.ask(GoalKind.MOVE, x0 + side * 1e-3, mask=1) == Refusal.FENCE
    held.ask(GoalKind.JOG, velocity=(side * li.speed, 0.0, 0.0, 0.0), mask=1, valid_ns=200 * MS)
    held.ticks(500)
    assert side * (held.setpoint[0] - x0) <= 0.0
    assert held.ask(GoalKind.MOVE, sum(fence) / 2, mask=1) == 0
    held.settle()
    assert held.setpoint[0] == sum(fence) / 2
    speeds = [abs(record["setpoint_velocity"][0]) for record in held.records[begun:]]
    assert 0.0 < max(speeds) <= 0.2 * li.speed * (1 + 1e-9)
