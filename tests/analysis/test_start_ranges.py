"""Where a task may begin, worked out beforehand, is where it breaks no limit when all of it is sampled from there."""

from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil.analysis.feasibility import corner_starts, violations
from hil.analysis.start_ranges import NOWHERE, ROUNDING, _Key, start_ranges
from hil.rig.file import load_rig
from tests.analysis.test_feasibility import AXES, rig_with, tasks
from tests.support.paths import RIGS

HAIR = 1e-5  # of the travel: what a border may be off by


@pytest.mark.parametrize("name", ["paper", "microscope-ideal"])
def test_the_shipped_rigs_may_begin_wherever_the_margin_of_their_travel_is_kept(name: str) -> None:
    rig = load_rig(RIGS / f"{name}.toml")
    found = start_ranges(rig)
    for place in corner_starts(rig).values():
        assert all(low <= value <= high for value, (low, high) in zip(place, found, strict=True))


def test_a_rig_is_known_again_by_its_rate_task_and_axes() -> None:
    """Simulations make many cycles of one rig, which is searched once; other names make another rig of it."""
    one, same, faster, named = (
        load_rig(RIGS / "microscope-ideal.toml", more) for more in ([], [], ["rate_hz=2000"], [])
    )
    named = named.model_copy(update={"axes": {name + "2": axis for name, axis in named.axes.items()}})
    assert _Key(one) == _Key(same)
    assert hash(_Key(one)) == hash(_Key(same))
    assert [_Key(one) == _Key(other) for other in (faster, named)] == [False, False]


def test_a_task_that_is_too_large_may_begin_nowhere() -> None:
    rig = load_rig(RIGS / "microscope-ideal.toml", ["task.kind=circle", 'task.axes=["x", "y"]', "task.radius=20"])
    assert start_ranges(rig)[:2] == [NOWHERE, NOWHERE]


def test_a_move_that_is_too_far_for_its_time_may_begin_near_its_target_only() -> None:
    sets = ["task.kind=point_to_point", 'task.axes=["x"]', "task.target=[0.02]", "task.move_s=0.1"]
    rig = load_rig(RIGS / "microscope-ideal.toml", sets)
    (low, high), *_ = start_ranges(rig)
    peak = 0.95 * 0.08 * 0.1 / 1.875  # of a minimum-jerk move, m
    assert low == pytest.approx(0.02 - peak, abs=2e-5)
    assert high == pytest.approx(0.02 + peak, abs=2e-5)


@pytest.mark.requirement(id="SR-4.4")
@pytest.mark.usefixtures("filterpy_loaded")
@given(tasks(), st.lists(st.floats(0.0, 1.0), min_size=2, max_size=2))
@settings(max_examples=25, suppress_health_check=list(HealthCheck))
def test_within_the_ranges_no_limit_is_broken_and_beyond_them_one_is(sets: dict[str, Any], at: list[float]) -> None:
    check(sets, at)


@pytest.mark.slow
@pytest.mark.usefixtures("filterpy_loaded")
def test_of_two_thousand_tasks() -> None:
    @given(tasks(), st.lists(st.floats(0.0, 1.0), min_size=2, max_size=2))
    @settings(max_examples=2000, suppress_health_check=list(HealthCheck))
    def all_of_them(sets: dict[str, Any], at: list[float]) -> None:
        check(sets, at)

    all_of_them()


def check(sets: dict[str, Any], at: list[float]) -> None:
    """Starts anywhere within the travel, and on either side of every border."""
    rig = rig_with(sets)
    found = start_ranges(rig)
    for index, name in enumerate(AXES):
        least, greatest = rig.axes[name].limits.position
        low, high = found[index]
        hair = HAIR * (greatest - least)
        places = [least + at[index] * (greatest - least)]
        if low <= high:
            places += [low, high, low - 2 * hair, high + 2 * hair, 0.5 * (low + high)]
        for place in places:
            if any(abs(place - border) < hair and place != border for border in (low, high)):
                continue
            start = [0.0, 0.0]
            start[index] = place
            found_there = [violation for violation in violations(rig, start) if violation.axis == name]
            broken = [one for one in found_there if abs(one.value - one.limit) > ROUNDING * abs(one.limit)]
            assert (low <= place <= high) != bool(broken), (name, place, low, high, broken)


@pytest.mark.parametrize("target", [0.0123, 0.0077, 0.0001, -0.0191])
def test_a_window_much_narrower_than_the_places_first_looked_at_is_found_around_its_target(target: float) -> None:
    sets = ["task.kind=point_to_point", 'task.axes=["x"]', f"task.target=[{target}]", "task.move_s=0.02"]
    rig = load_rig(RIGS / "microscope-ideal.toml", sets)
    (low, high), *_ = start_ranges(rig)
    assert low < target < high
    assert target - low == pytest.approx(high - target, rel=0.01)
    assert high - low < 0.002
