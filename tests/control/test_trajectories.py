"""Trajectories: exact in time, smooth where they must be, the same bits for one instant or a thousand."""

import math
from fractions import Fraction
from typing import get_args

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hil.control.laws.base import axis_inputs
from hil.control.setpoints import Setpoints
from hil.control.trajectories import Trajectory, make_trajectory, plan_task, task_repeat
from hil.control.trajectories.chosen_axes import ChosenAxes
from hil.control.trajectories.displaced import Displaced
from hil.control.trajectories.figures import rational_hz
from hil.control.trajectories.segments import Segments
from hil.rig.file import load_rig
from hil.rig.schema import InjectionConfig, TaskConfig
from tests.golden.golden import hold
from tests.golden.trajectories.tell import stories
from tests.support.paths import RIGS

MS = 1_000_000
PERIOD = MS
CIRCLE = TaskConfig(kind="circle", axes=["x", "y"], radius=0.5, frequency_hz=0.5, approach_s=2.0)
LISSAJOUS = TaskConfig(kind="lissajous", axes=["x", "y"], radius=0.01, frequency_hz=0.3, ratio=3, phase=0.7)
MOVES = TaskConfig(kind="point_to_point", axes=["y"], target=[0.2], move_s=0.5, dwell_s=0.25)
HOLD = TaskConfig()
SPIRAL = TaskConfig(kind="spiral", axes=["x", "y"], radius=0.01, turns=2.0, move_s=4.0)
WAYPOINTS = TaskConfig(kind="waypoints", axes=["x", "y"], waypoints=[[0.0, 0.0], [0.05, 0.02], [0.01, 0.0]])
SPLINE = WAYPOINTS.model_copy(update={"kind": "spline", "repeat": True})
BLENDED = WAYPOINTS.model_copy(update={"blend": 5e-3})
RASTER = TaskConfig(kind="raster", axes=["x", "y"], corner=[0.0, 0.01], size=[0.02, 0.01], lines=4, blend=1e-3)
PATH = TaskConfig(kind="path", axes=["y"], samples=[[0.0, 0.0], [0.5, 0.01], [1.0, 0.03], [2.0, 0.0]])


def injection_task() -> TaskConfig:
    return load_rig(RIGS / "microscope-ideal.toml").task


def trajectories() -> list[Trajectory]:
    """None of the first has anything to do with z."""
    start = np.array([0.03, -0.02, 0.01])
    made = [make_trajectory(task, ["x", "y", "z"], start, PERIOD) for task in TASKS]
    injection = make_trajectory(injection_task(), ["x", "y", "z", "theta"], np.zeros(4), PERIOD)
    return [*made, injection, Displaced(made[0], 3, 1, 0.1, 0.0)]


TASKS = [CIRCLE, LISSAJOUS, MOVES, HOLD, SPIRAL, WAYPOINTS, BLENDED, SPLINE, RASTER, PATH]
NAMES = [*(task.kind for task in TASKS), "injection", "displaced"]
ALL = trajectories()


def test_every_kind_of_task_is_tried_here() -> None:
    assert set(get_args(TaskConfig.model_fields["kind"].annotation)) <= set(NAMES)


@pytest.mark.parametrize("story", stories())
def test_every_task_asks_for_the_motion_it_always_did(story: str) -> None:
    hold("trajectories", story)


@pytest.mark.parametrize("trajectory", trajectories(), ids=NAMES)
def test_one_instant_and_a_batch_agree_bit_for_bit(trajectory: Trajectory) -> None:
    times = np.random.default_rng(1).integers(-MS, 20_000 * MS, size=(200, trajectory._n))
    batch = trajectory.sample(times)
    for row, each in enumerate(times):
        single = trajectory.sample(each)
        for name in ("position", "velocity", "acceleration"):
            assert np.array_equal(getattr(single, name), getattr(batch, name)[row])


@pytest.mark.parametrize("trajectory", trajectories()[: len(TASKS)], ids=NAMES[: len(TASKS)])
def test_an_axis_that_a_task_does_not_name_stays_where_it_is(trajectory: Trajectory) -> None:
    times = np.arange(0, 6_000 * MS, 7 * MS)
    stays = [(0.01, 0.0, 0.0)] * len(times)
    assert [trajectory.at(2, t_ns) for t_ns in times.tolist()] == stays
    assert list(zip(*(column.tolist() for column in trajectory.sample_axis(2, times)), strict=True)) == stays


@pytest.mark.parametrize("trajectory", trajectories(), ids=NAMES)
def test_velocity_and_acceleration_are_the_derivatives_of_position(trajectory: Trajectory) -> None:
    n = trajectory._n
    h = 50_000  # ns
    times = np.random.default_rng(2).integers(MS, 20_000 * MS, size=(300, n))
    before, here, after = (trajectory.sample(times + shift) for shift in (-h, 0, h))
    step = h * 1e-9
    scale = 1.0 + np.abs(here.acceleration).max()
    slope = (after.position - before.position) / (2 * step)
    assert np.abs(slope - here.velocity).max() < 1e-6 * scale
    bend = (after.velocity - before.velocity) / (2 * step)
    assert np.abs(bend - here.acceleration).max() < 0.02 * scale  # jerk may step at a join; acceleration may not


def test_before_its_start_a_trajectory_stands_at_its_start() -> None:
    for trajectory in trajectories():
        early = trajectory.sample(np.full((1, trajectory._n), -5 * MS))
        begin = trajectory.sample(np.zeros((1, trajectory._n), np.int64))
        assert np.array_equal(early.position, begin.position)
        assert not early.velocity.any()


def test_a_figure_begins_at_the_instant_at_which_its_approach_ends() -> None:
    circle = make_trajectory(CIRCLE, ["x", "y"], np.zeros(2), PERIOD)
    begins = circle.repeat_from_ns
    assert [circle.phase_names[circle.phase_at(begins + ns)] for ns in (-1, 0)] == ["approach", "figure"]


def test_circle_is_the_papers_after_the_approach() -> None:
    circle = make_trajectory(CIRCLE, ["x", "y"], np.zeros(2), PERIOD)
    t = 3.3
    sample = circle.sample(np.full((1, 2), round(t * 1e9)))
    assert sample.position[0] == pytest.approx([0.5 * math.cos(math.pi * t), 0.5 * math.sin(math.pi * t)], abs=1e-14)
    assert circle.phase_names[circle.phase_at(round(t * 1e9))] == "figure"


def test_circle_reverses_exactly_on_the_grid_after_a_day() -> None:
    circle = make_trajectory(CIRCLE, ["x", "y"], np.zeros(2), PERIOD)
    day = 86_400 * 1_000 * MS
    assert circle.sample(np.full((1, 2), day)).velocity[0, 0] == 0.0
    assert circle.sample(np.full((1, 2), day)).position[0, 0] == 0.5


@given(st.floats(0.001, 1000.0), st.integers(0, 10**14))
@settings(max_examples=60)
def test_any_frequency_keeps_its_phase(frequency: float, t_ns: int) -> None:
    task = CIRCLE.model_copy(update={"frequency_hz": frequency})
    trajectory = make_trajectory(task, ["x", "y"], np.zeros(2), PERIOD)
    sample = trajectory.sample(np.full((1, 2), t_ns + 10**10))
    assert np.hypot(*sample.position[0]) == pytest.approx(0.5, rel=1e-12)


@example(7e-6)
@example(7 / 1_000_001)
@given(st.floats(1e-6, 1e4) | st.decimals(1, 10_000, places=6).map(float))
def test_a_frequency_is_the_finest_decimal_fraction_whose_phase_fits_64_bits(frequency: float) -> None:
    denominators = (10**digits for digits in range(6, -1, -1))
    fractions = (Fraction(repr(frequency)).limit_denominator(most) for most in denominators)
    cycles = ((hz, hz / 10**9) for hz in fractions)  # a phase is t * numerator modulo denominator
    assert rational_hz(frequency) == next(hz for hz, c in cycles if c.numerator * c.denominator < 2**62)


@given(st.integers(0, 11), st.integers(0, 2), st.floats(-0.1, 0.1), st.floats(-1.0, 1.0), st.integers(0, 10**11))
def test_a_displaced_trajectory_is_the_honest_one_but_for_one_axis(
    kind: int, axis: int, position: float, velocity: float, t_ns: int
) -> None:
    honest = ALL[kind]
    axis %= honest._n
    displaced = Displaced(honest, honest._n, axis, position, velocity)
    for fact in ("duration_ns", "steady_from_ns", "repeat_ns", "repeat_from_ns", "phase_names"):
        assert getattr(displaced, fact) == getattr(honest, fact)
    assert displaced.phase_at(t_ns) == honest.phase_at(t_ns)
    for each in range(honest._n):
        q, v, a = honest.at(each, t_ns)
        moved = (q + position, v + velocity, a)
        assert displaced.at(each, t_ns) == (moved if each == axis else (q, v, a))


def test_some_axes_of_a_trajectory_repeat_as_it_does() -> None:
    whole = make_trajectory(CIRCLE, ["x", "y"], np.zeros(2), PERIOD)
    kept = ChosenAxes(whole, [1])
    assert (kept.repeat_ns, kept.repeat_from_ns) == (whole.repeat_ns, whole.repeat_from_ns) != (None, 0)
    assert kept.at(0, 10**9) == whole.at(1, 10**9)


@pytest.mark.parametrize(
    ("off", "first"), [(1e-6, "approach"), (-1e-6, "approach"), (1.01e-6, "home"), (-1.01e-6, "home")]
)
def test_an_injection_goes_home_first_from_wherever_else_the_stage_stands(off: float, first: str) -> None:
    task = injection_task()
    assert task.injection is not None
    for axis in range(4):
        start = np.array(task.injection.home)
        assert start[axis] == 0.0
        start[axis] = off
        trajectory = make_trajectory(task, ["x", "y", "z", "theta"], start, PERIOD)
        assert trajectory.phase_names[trajectory.phase_at(1)] == first
        assert trajectory.sample(np.zeros(4, np.int64)).position.tolist() == start.tolist()


def test_start_elsewhere_is_blended_without_a_jump() -> None:
    circle = make_trajectory(CIRCLE, ["x", "y"], np.array([0.1, -0.3]), PERIOD)
    times = np.arange(0, 2_100 * MS, MS)
    path = circle.sample(np.stack([times, times], axis=1))
    assert path.position[0].tolist() == [0.1, -0.3]
    assert np.abs(np.diff(path.position, axis=0)).max() < 3e-3  # no step larger than the fastest millisecond


def test_injection_is_fastest_at_contact_and_rests_in_the_cell() -> None:
    task = injection_task()
    plan = task.injection
    assert plan is not None
    trajectory = make_trajectory(task, ["x", "y", "z", "theta"], np.zeros(4), PERIOD)
    assert trajectory.duration_ns is not None
    times = np.arange(0, trajectory.duration_ns, MS // 4)
    path = trajectory.sample(np.repeat(times[:, None], 4, axis=1))
    phases = np.array([trajectory.phase_at(int(t)) for t in times])
    names = trajectory.phase_names
    struck = (phases == names.index("strike")) | (phases == names.index("pierce"))
    speed = np.abs(path.velocity[:, 2])
    assert speed[struck].max() == pytest.approx(plan.contact_speed, rel=1e-6)
    fastest = np.flatnonzero(struck & (speed == speed[struck].max()))[0]
    assert path.position[fastest, 2] == pytest.approx(plan.contact[2], abs=1e-6)
    assert not speed[phases == names.index("dwell")].any()
    cells = np.unique(path.position[phases == names.index("dwell"), 0].round(9))
    assert len(cells) == plan.cells
    end = trajectory.sample(np.full((1, 4), trajectory.duration_ns + MS))
    assert end.position[0].tolist() == plan.home


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("contact_speed", 1.0, "contact_speed = 1.0 m/s"),
        ("contact", [0.0, 0.0, 0.0, 0.0], "contact"),
        ("contact", None, "must lie between start and end"),
        ("end", [0.004, 0.002, -0.0038, 0.02], "must lie between start and end"),  # where contact is
        ("end", None, "must differ from start"),
    ],
)
def test_an_impossible_injection_names_key_value_and_range(key: str, value: object, message: str) -> None:
    task = injection_task()
    assert task.injection is not None
    changed = task.injection.model_copy(update={key: task.injection.start if value is None else value})
    broken = task.model_copy(update={"injection": InjectionConfig.model_validate(changed.model_dump())})
    with pytest.raises(ValueError, match=message):
        make_trajectory(broken, ["x", "y", "z", "theta"], np.zeros(4), PERIOD)


def test_a_long_plan_is_begun_without_working_it_out_again() -> None:
    """It begins in a tick, with the drives just enabled: five thousand segments took a fifth of a second there."""
    task = injection_task()
    assert task.injection is not None
    row = task.injection.model_copy(update={"cells": 1000})
    begin = plan_task(task.model_copy(update={"injection": row}), ["x", "y", "z", "theta"], PERIOD)
    here, elsewhere = begin(row.home), begin([1e-4] * 4)
    assert isinstance(here, Segments)
    assert isinstance(elsewhere, Segments)
    assert here.segments[0] is not elsewhere.segments[0]
    assert all(mine is other for mine, other in zip(here.segments[1:], elsewhere.segments[2:], strict=True))
    assert elsewhere.at(0, 0)[0] == 1e-4


def test_what_repeats_says_so() -> None:
    assert task_repeat(CIRCLE, ["x", "y"], PERIOD) == (2_000 * MS, 2_000 * MS)
    assert task_repeat(MOVES, ["x", "y"], PERIOD) == (1_500 * MS, 0)
    assert task_repeat(HOLD, ["x", "y"], PERIOD) is None
    assert task_repeat(injection_task(), ["x", "y", "z", "theta"], PERIOD) is None


def test_setpoints_that_hold_rest_there_and_follow_nothing_any_more() -> None:
    inputs = [axis_inputs(), axis_inputs()]
    setpoints = Setpoints(inputs, PERIOD)
    setpoints.follow(make_trajectory(CIRCLE, ["x", "y"], np.zeros(2), PERIOD), [0, 0])
    setpoints.update([500 * MS] * 2, [501 * MS] * 2)
    assert inputs[0].sample.velocity != 0.0
    assert (setpoints.task_ns, inputs[0].task_ns) == (500 * MS, 501 * MS)
    setpoints.hold([0.25, -0.5])
    for _ in range(2):
        for x, place in zip(inputs, (0.25, -0.5), strict=True):
            rests = [(r.position, r.velocity, r.acceleration) for r in (x.sample, x.start, x.end)]
            assert rests == [(place, 0.0, 0.0)] * 3
            assert (x.mean_velocity, x.mean_acceleration, x.mean_sign, x.task_ns) == (0.0, 0.0, 0.0, -1)
        assert setpoints.task_ns == -1
        setpoints.update([600 * MS] * 2, [601 * MS] * 2)


@pytest.mark.parametrize(
    ("seconds", "periods"), [(0.0, 1), (0.0014, 1), (0.0016, 2), (0.0024, 2), (0.2504, 250), (0.2506, 251)]
)
def test_a_duration_is_the_nearest_number_of_whole_periods_and_at_least_one(seconds: float, periods: int) -> None:
    moves = MOVES.model_copy(update={"move_s": seconds, "dwell_s": 0.0})
    assert make_trajectory(moves, ["x", "y"], (0.0, 0.0), MS).repeat_ns == 2 * periods * MS
    around = CIRCLE.model_copy(update={"approach_s": seconds, "settle_s": 0.5})
    circle = make_trajectory(around, ["x", "y"], (0.0, 0.0), MS)
    assert (circle.repeat_from_ns, circle.steady_from_ns) == (periods * MS, periods * MS + 500 * MS)
