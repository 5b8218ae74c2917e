"""Knots of a stream, one axis: which plan a new one begins with, and the acceleration that its neighbours give it."""

import math
from itertools import pairwise

import pytest

from hil.control.plans.axis_plan import AxisPlan, MotionLimits
from hil.control.plans.course import Course, Stretch
from hil.control.plans.moves import knot
from hil.control.plans.stream import MOST_AHEAD, Knot, follow_on

MS = 1_000_000
LIMITS = MotionLimits(0.1, 2.0, 200.0, -0.01, 0.01)
H = 100 * MS


def swing(t: float) -> tuple[float, float, float]:
    """Position, velocity, acceleration of a path."""
    turn = 2.0 * math.pi
    return 1e-3 * math.sin(turn * t), 1e-3 * turn * math.cos(turn * t), -1e-3 * turn * turn * math.sin(turn * t)


def knots(count: int) -> list[Knot]:
    found = [Knot(0, *swing(0.0)[:2])]
    for k in range(1, count):
        found.append(found[-1].next(k * H, *swing(k * 0.1)[:2]))
    return found


def test_a_knot_between_two_has_the_acceleration_of_the_path_and_the_newest_nearly() -> None:
    _, one, two, three = knots(4)
    between, newest = one.bend(two, 2.0), one.rise
    true = swing(0.1)[2]
    assert abs(between - true) < 0.001 * abs(true) < 0.1 * abs(true) < abs(newest - true)
    assert two.bend(three, 1e-3) == -1e-3, "at most what the axis may have"


@pytest.mark.parametrize("after", [20, 50, 130])
def test_a_path_of_fifth_order_is_found_whatever_the_times(after: int) -> None:
    def at(t: float) -> tuple[float, float]:
        return t * (1.0 + t * (2.0 + t * (3.0 + t * (4.0 + 5.0 * t)))), 1.0 + t * (
            4.0 + t * (9.0 + t * (16.0 + 25.0 * t))
        )

    first = Knot(-50 * MS, *at(-0.05))
    here = first.next(0, *at(0.0))
    assert here.bend(here.next(after * MS, *at(after * 1e-3)), 9.0) == pytest.approx(4.0, rel=1e-12)


def test_places_that_do_not_belong_to_the_speeds_count_for_nothing() -> None:
    """The mean of the speeds' rises then: a constant acceleration is found whatever the times."""
    first = Knot(0, 0.0, 0.0)
    second = first.next(30 * MS, 0.0, 0.03)
    assert second.bend(second.next(130 * MS, 0.0, 0.13), 9.0) == pytest.approx(1.0)


def test_a_knot_out_of_order_follows_none() -> None:
    last = knots(3)[-1]
    assert last.next(3 * H, 0.0, 0.0).after == pytest.approx(0.1)
    assert not last.next(2 * H, 0.0, 0.0).after
    assert not last.next(1 * H, 0.0, 0.0).after


@pytest.mark.parametrize("place", [5e-324, 1e-300, 1e-170])
def test_a_knot_next_to_one_at_rest_divides_by_nothing(place: float) -> None:
    """The time between them was 1e-300 s, and its square 0."""
    assert Knot(0).next(1_000_000, place, 1.0).after == pytest.approx(1e-3)


def test_from_rest_an_axis_sets_off_as_late_as_a_steady_acceleration_allows() -> None:
    made = knot(0.0, 0.0, 0.0, (1e-4, 2e-3, 0.02), 0.26, LIMITS)
    assert made is not None
    assert made.low == 0.0, "it never runs back first, to have a longer way"
    assert made.at(0.159) == (0.0, 0.0, 0.0)
    assert made.at(0.21)[2] == pytest.approx(0.02, rel=0.02)
    assert made.at(0.26)[:2] == pytest.approx((1e-4, 2e-3), rel=1e-9)
    assert Knot(0, 0.0, 0.0).next(260 * MS, 1e-4, 2e-3)[3:] == pytest.approx((0.02, 0.1, 0.01))
    hasty = knot(0.0, 0.0, 0.0, (1e-4, 2e-3, 0.02), 0.08, LIMITS)
    assert hasty is not None
    assert hasty.at(0.08)[:2] == pytest.approx((1e-4, 2e-3), rel=1e-9)
    assert knot(0.0, 0.0, 0.0, (-1e-4, 2e-3, 0.02), 0.26, LIMITS).low < -1e-4, "which has to run back"


def test_a_stream_goes_through_each_of_its_knots_and_near_the_path_between_them() -> None:
    course, found = Course([0.0]), knots(8)
    for last, new in pairwise(found):
        base = max(last.due_ns - H, 0)  # two intervals before it is due
        begins = follow_on(course, 0, last, new, base, LIMITS)
        assert begins == last.due_ns
        made = knot(*course.at(0, begins), (new.place, new.speed, new.rise), (new.due_ns - begins) * 1e-9, LIMITS)
        assert made is not None
        course.add(0, Stretch(begins, made, follows=begins > base))
        if last.due_ns:
            assert course.at(0, last.due_ns)[:2] == pytest.approx((last.place, last.speed), abs=1e-15)
        # the way to the knot before is planned again, so that it ends in the acceleration that is known by now
        if last.due_ns > H:
            half = last.due_ns - H // 2
            assert course.at(0, half)[0] == pytest.approx(swing(half * 1e-9)[0], abs=5e-8)


def test_a_new_knot_begins_where_the_axis_is_once_too_many_are_ahead_or_the_last_is_behind() -> None:
    course, found = Course([0.0]), knots(MOST_AHEAD + 3)
    course.add(0, Stretch(-H, AxisPlan(0.0, 0.0, 0.0)))
    for ahead in range(MOST_AHEAD):
        course.add(0, Stretch((ahead + 1) * H, AxisPlan(0.0, 0.0, 0.0), follows=True))
    last, new = found[-2:]
    assert follow_on(course, 0, last, new, 0, LIMITS) == 0
    assert follow_on(course, 0, last, new, last.due_ns, LIMITS) == last.due_ns
    assert follow_on(course, 0, last, Knot(new.due_ns), 0, LIMITS) == 0


def test_what_follows_a_knot_gives_way_and_a_rest_along_a_path_does_not() -> None:
    course = Course([0.0])
    course.add(0, Stretch(2 * H, AxisPlan(0.0, 0.0, 0.0)))
    assert course.free(0, H) == 2 * H
    course.add(0, Stretch(3 * H, AxisPlan(0.0, 0.0, 0.0), follows=True))
    assert (course.free(0, H), course.ahead(0, H)) == (2 * H, 2)
    assert course.free(0, 5 * H // 2) == 5 * H // 2
    course.add(0, Stretch(2 * H, AxisPlan(1e-3, 0.0, 0.0)))
    assert course.newest(0).begins == 2 * H
    assert course.at(0, 4 * H)[0] == 1e-3
