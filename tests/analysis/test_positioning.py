"""The figures of ISO 230-2 against numbers worked out by hand, and what must not change them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.analysis.positioning import positioning, targets

MICRO = 1e-6


def test_a_table_worked_out_by_hand() -> None:
    # targets 1 and 2, two runs; um. Means up 1, 4; down -1, 3; standard deviations of two runs: difference / sqrt 2.
    up = np.array([[0.0, 2.0], [3.0, 5.0]]) * MICRO
    down = np.array([[-1.0, -1.0], [2.0, 4.0]]) * MICRO
    found = positioning(up, down)
    s = 2.0**0.5
    assert found.reversal == pytest.approx(2.0 * MICRO)
    assert found.systematic == pytest.approx((4.0 - -1.0) * MICRO)
    assert found.mean_range == pytest.approx((3.5 - 0.0) * MICRO)
    assert found.repeatability_up == pytest.approx(4.0 * s * MICRO)
    assert found.repeatability_down == pytest.approx(4.0 * s * MICRO)
    assert found.repeatability == pytest.approx(max(2 * s + 0 + 2, 4 * s, 2 * s + 2 * s + 1) * MICRO)
    assert found.accuracy_up == pytest.approx((4.0 + 2 * s - (1.0 - 2 * s)) * MICRO)
    assert found.accuracy_down == pytest.approx((3.0 + 2 * s - -1.0) * MICRO)
    assert found.accuracy == pytest.approx((4.0 + 2 * s - (1.0 - 2 * s)) * MICRO)


def test_an_axis_that_is_always_off_by_the_same_is_perfect_by_all_but_its_offset() -> None:
    found = positioning(np.full((5, 5), 3e-6), np.full((5, 5), 3e-6))
    assert (found.accuracy, found.repeatability, found.reversal, found.systematic) == pytest.approx(
        (0.0,) * 4, abs=1e-20
    )


@given(st.integers(0, 2**32 - 1), st.floats(-1e-3, 1e-3))
def test_an_offset_changes_none_of_them_and_lost_motion_is_the_reversal(seed: int, offset: float) -> None:
    random = np.random.default_rng(seed)
    up, down = random.normal(0.0, 1e-6, (2, 6, 5))
    plain, moved = positioning(up, down), positioning(up + offset, down + offset)
    assert moved[:9] == pytest.approx(plain[:9], abs=1e-15)
    lost = positioning(up, up - 5e-6)
    assert lost.reversal == pytest.approx(5e-6)
    assert lost.accuracy >= lost.accuracy_up
    assert lost.repeatability >= lost.reversal


@pytest.mark.parametrize("shape", [(5,), (5, 1), (0, 2)])
def test_too_few_runs_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected \\(targets, runs\\), 2 runs or more"):
        positioning(np.zeros(shape), np.zeros(shape))


def test_targets_reach_both_ends_rise_and_lie_on_no_even_grid() -> None:
    places = targets(-0.02, 0.02, 7)
    steps = np.diff(places)
    assert (places[0], places[-1], len(places)) == (-0.02, 0.02, 7)
    assert steps.min() > 0.0
    assert np.ptp(steps) > 0.1 * steps.mean()
    assert places == targets(-0.02, 0.02, 7)
