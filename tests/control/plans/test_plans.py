"""Plans of goals: they end at rest on their target, keep every limit, and are as quick as can be."""

import random
from itertools import pairwise

import pytest
import ruckig

from hil.control.plans.axis_plan import AxisPlan, MotionLimits
from hil.control.plans.course import Course, Stretch
from hil.control.plans.moves import halt, jog, knot, move
from hil.control.plans.pace import Pace, change_rate
from hil.control.plans.ramps import add_ramp
from hil.control.plans.together import line, moves
from hil.control.trajectories import Trajectory, make_trajectory
from hil.rig.schema import TaskConfig
from tests.support.hostile_everywhere import commands, hashes_of
from tests.support.hostile_goals import AXES, hostile

LIMITS = AXES[0]
MS = 1_000_000  # ns


@pytest.mark.parametrize("seed", range(5))
def test_no_goal_at_any_instant_leads_to_a_plan_that_breaks_a_limit_or_jumps(seed: int) -> None:
    assert hostile(seed, 2_000).limited < 2_000


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_the_same_at_length(seed: int) -> None:
    hostile(seed, 1_000_000)


def test_hostile_set_points_have_the_same_bits_everywhere() -> None:
    """On every Python, processor and build; a change of the plans' arithmetic changes this on purpose."""
    assert hostile(0, 1_000).sha256 == "6bf64c40c97d3b41eb155930b80d888e62d6af5222fe24a91bc2dc007b42de40"


@pytest.mark.long
def test_every_python_that_is_found_makes_the_same_set_points() -> None:
    """Without packages; what is left out, and arm64, is said by `python -m tests.support.hostile_everywhere`."""
    expected = [hostile(seed, 300).sha256 for seed in range(2)]
    found = {name: hashes_of(python, 300, 2) for name, python, _ in commands(None) if python}
    assert found == dict.fromkeys(found, expected)


def optimum(p: float, v: float, a: float, target: float, limits: MotionLimits) -> float:
    """ruckig's duration, s."""
    asked, made = ruckig.InputParameter(1), ruckig.Trajectory(1)
    asked.current_position, asked.current_velocity, asked.current_acceleration = [p], [v], [a]
    asked.target_position, asked.max_velocity = [target], [limits.speed]
    asked.max_acceleration, asked.max_jerk = [limits.acceleration], [limits.jerk]
    assert ruckig.Ruckig(1).calculate(asked, made) in (ruckig.Result.Working, ruckig.Result.Finished)
    return float(made.duration)


def test_a_move_takes_hardly_longer_than_the_quickest_there_is() -> None:
    draw, ratios, plan = random.Random(5), [], halt(0.0, 0.0, 0.0, LIMITS)
    for _ in range(2_000):
        p, v, a = plan.at(draw.choice((plan.ends, draw.random() * plan.ends)))
        target = LIMITS.low + draw.random() * (LIMITS.high - LIMITS.low)
        plan = move(p, v, a, target, LIMITS)
        best = optimum(p, v, a, target, LIMITS)
        assert plan.ends <= best + 4e-3
        ratios.append(plan.ends / max(best, 1e-3))
    ratios.sort()
    assert ratios[int(0.99 * len(ratios))] <= 1.03


@pytest.mark.parametrize("limits", AXES)
def test_a_move_from_rest_to_rest_is_within_a_thousandth_of_the_quickest(limits: MotionLimits) -> None:
    draw = random.Random(1)
    for _ in range(200):
        start, target = (limits.low + draw.random() * (limits.high - limits.low) for _ in range(2))
        assert move(start, 0.0, 0.0, target, limits).ends <= 1.001 * optimum(start, 0.0, 0.0, target, limits) + 2e-5


def test_a_move_ends_on_its_target_exactly_and_a_move_to_where_it_stands_does_nothing() -> None:
    plan = move(1e-3, 0.0, 0.0, 0.0123456789 / 2, LIMITS)
    assert plan.at(plan.ends)[0] == plan.at(1e3)[0] == 0.0123456789 / 2
    assert move(1e-3, 0.0, 0.0, 1e-3, LIMITS).ends == 0.0


def test_the_same_target_asked_for_again_on_the_way_changes_nothing_to_speak_of() -> None:
    plan = move(0.0, 0.0, 0.0, 0.01, LIMITS)
    ends, t = plan.ends, 0.0
    for _ in range(100):
        state = plan.at(0.002)
        plan, t = move(*state, 0.01, LIMITS), t + 0.002
    assert t + plan.ends == pytest.approx(ends, rel=1e-3)


def test_a_halt_next_to_the_fence_turns_back_where_braking_alone_would_leave_it() -> None:
    """A stream may leave an axis reversing: releasing the brake first, as the quickest stop does, is then too far."""
    limits = MotionLimits(1.0, 10.0, 100.0, -1.0, 1.0)
    state = (0.9, 0.05, -10.0)
    plain = AxisPlan(*state)
    add_ramp(plain, 0.0, limits)
    tight = MotionLimits(1.0, 10.0, 100.0, -1.0, plain.high - 1e-6)
    assert not plain.keeps(tight)
    assert halt(*state, tight).keeps(tight)
    assert halt(*state, limits).ends == plain.ends


def test_a_jog_cruises_until_it_is_no_longer_asked_for_and_stops_at_the_fence() -> None:
    plan = jog(0.0, 0.0, 0.0, 0.01, 0.3, LIMITS)
    assert plan.at(0.2)[1] == 0.01
    assert 0.3 < plan.ends < 0.4
    assert plan.at(0.29)[0] < plan.target == pytest.approx(0.003, rel=0.1)
    fenced = jog(0.011, 0.0, 0.0, 0.08, 0.5, LIMITS)
    assert fenced.target == LIMITS.high
    assert fenced.keeps(LIMITS)


def test_a_short_jog_never_reaches_its_speed() -> None:
    plan = jog(0.0, 0.0, 0.0, 0.08, 0.002, LIMITS)
    assert 0.0 < plan.speed < 0.01


def test_a_knot_is_met_in_time_and_stopped_behind() -> None:
    plan = knot(0.0, 0.0, 0.0, (1e-3, 0.02, 0.0), 0.1, LIMITS)
    assert plan is not None
    assert plan.at(0.1) == pytest.approx((1e-3, 0.02, 0.0), abs=1e-12)
    assert plan.target > 1e-3


@pytest.mark.parametrize("to", [(0.012, 0.01, 0.0), (0.01, 0.0, 0.0), (1e-3, 0.09, 0.0)])
def test_a_knot_beyond_what_the_limits_allow_is_none(to: tuple[float, float, float]) -> None:
    """Beyond the fence with its stop, too far for the time, too fast."""
    assert knot(0.0, 0.0, 0.0, to, 0.02, LIMITS) is None


@pytest.mark.parametrize("way", [5e-324, 1e-300, 1e-80, 1e-30])
def test_a_knot_next_to_an_axis_at_rest_is_met_or_refused_and_divides_by_nothing(way: float) -> None:
    """The time under way was 1e-300 s, and its fifth power 0: a motion could end the control process so."""
    for speed in (5e-324, 1e-300, 1e-9):
        plan = knot(0.0, 0.0, 0.0, (way, speed, 0.0), 1e-3, LIMITS)
        assert plan is not None
        assert plan.keeps(LIMITS)
    for speed in (1.0, 9.0, 1e300):
        assert knot(0.0, 0.0, 0.0, (way, speed, 0.0), 1e-3, LIMITS) is None


def test_axes_arrive_together() -> None:
    states = [(0.0, 0.0, 0.0), (1e-3, 0.01, 0.5), (0.0, 0.0, 0.0)]
    plans = moves(states, [0.01, 0.002, 0.0], [LIMITS] * 3)
    assert [plan.target for plan in plans] == [0.01, 0.002, 0.0]
    assert plans[1].ends == pytest.approx(plans[0].ends, rel=1e-4)


def test_a_line_is_straight_from_where_the_axes_have_stopped() -> None:
    states = [(0.0, 0.03, 0.0), (1e-3, 0.0, 0.0)]
    plans = line(states, [0.01, -0.005], [LIMITS, LIMITS])
    begin, end = halt(*states[0], LIMITS), max(plan.ends for plan in plans)
    for k in range(1, 20):
        t = begin.ends + (end - begin.ends) * k / 20.0
        x, y = plans[0].at(t)[0], plans[1].at(t)[0]
        share = (x - begin.target) / (0.01 - begin.target)
        assert y == pytest.approx(1e-3 - 0.006 * share, abs=1e-12)
    assert all(plan.keeps(LIMITS) for plan in plans)
    assert [plan.target for plan in plans] == [0.01, -0.005]


# the rate of a path's time --------------------------------------------------------------------------------------------


def figure() -> Trajectory:
    task = TaskConfig(kind="circle", axes=["x", "y"], radius=5e-3, frequency_hz=1.0, approach_s=0.5)
    return make_trajectory(task, ["x", "y"], [0.0, 0.0], MS)


def test_a_pause_stays_on_the_path_and_within_what_the_axes_have() -> None:
    path, limits = figure(), [MotionLimits(0.1, 2.0, 100.0, -0.01, 0.01)] * 2
    at = [1_000 * MS, 1_000 * MS]
    pace = change_rate(path, at, 1.0, 0.0, 0.0, limits)
    assert pace is not None
    course = Course([0.0, 0.0], path)
    for axis in range(2):
        course.add(axis, Stretch(at[axis], AxisPlan(0.0, 0.0, 0.0), path, pace, at[axis]))
    for t in range(990 * MS, 1_200 * MS, MS):
        x, y = course.at(0, t), course.at(1, t)
        assert (x[0] ** 2 + y[0] ** 2) ** 0.5 == pytest.approx(5e-3, rel=1e-9)
        assert max(abs(x[2]), abs(y[2])) <= 2.002
    assert course.at(0, 2_000 * MS)[1:] == (0.0, 0.0)


def test_a_rate_is_continuous_in_all_derivatives() -> None:
    pace = Pace(1.0, 0.0, 0.0, 20.0)
    step = pace.ends / 1000
    slopes = [pace.at(k * step)[2] for k in range(1001)]
    assert max(abs(b - a) for a, b in pairwise(slopes)) <= 20.0 / 0.02 * step * 1.001
    assert pace.at(pace.ends + 1.0) == (pace.way, 0.0, 0.0)


def test_a_path_too_fast_to_be_stopped_within_an_axis_limits_is_stopped_more_slowly_or_not_at_all() -> None:
    path = figure()
    weak = [MotionLimits(0.1, 0.02, 100.0, -0.01, 0.01)] * 2
    quick, slow = (change_rate(path, [1_000 * MS] * 2, 1.0, 0.0, 0.0, li) for li in (
        [MotionLimits(0.1, 2.0, 100.0, -0.01, 0.01)] * 2, weak))  # fmt: skip
    assert quick is not None
    assert slow is None or slow.ends > 4.0 * quick.ends


def test_a_course_remembers_what_was_before_for_samples_that_are_older() -> None:
    course, plan = Course([0.0]), move(0.0, 0.0, 0.0, 0.01, LIMITS)
    course.add(0, Stretch(100 * MS, plan))
    assert course.at(0, 99 * MS) == (0.0, 0.0, 0.0)
    before = course.at(0, 120 * MS)
    again = course.at(0, 130 * MS)
    course.add(0, Stretch(130 * MS, halt(*again, LIMITS)))
    assert course.at(0, 120 * MS) == before
    assert course.at(0, 130 * MS) == again
