"""A step of the position is told from a push: the second difference takes a step back at once, and a push goes on."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.events.axis_model import AxisModel, Floats, Steps, in_step, steps

AXIS = AxisModel(resolution=5e-9, mass=0.9, dry=0.6, wet=3.0, gravity=0.0)
PERIOD_S = 1e-3
TICKS = 128
AT = 60
SINCE: Floats = np.maximum(np.arange(TICKS, dtype=np.float64) - AT, 0.0)  # ticks
STEP = 2e-4  # m
PUSHED = 1e3  # m/s^2: a thousandth of a millimetre more in every tick than in the one before, 900 N


def seen(position: NDArray[Any]) -> Steps:
    """Of an axis that no force acts on."""
    return steps(AXIS, PERIOD_S, position, np.zeros(TICKS), np.zeros(TICKS))


@pytest.mark.parametrize("first", [1, AT, TICKS - 1])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_position_that_steps_is_told_wherever_in_the_window_it_does(first: int, way: float) -> None:
    found = seen(np.where(np.arange(TICKS) >= first, way * STEP, 0.0))
    assert found.beyond in (1, 2)
    assert found.worst[0] == pytest.approx(STEP)
    assert not found.good


def test_a_glitch_of_one_tick_is_a_step_there_and_back() -> None:
    position = np.zeros(TICKS)
    position[AT] = STEP
    found = seen(position)
    assert found.beyond == 3
    assert found.worst[0] == pytest.approx(2.0 * STEP)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_an_axis_that_is_pushed_harder_than_its_drive_can_push_has_not_stepped(way: float) -> None:
    found = seen(way * 0.5 * PUSHED * (SINCE * PERIOD_S) ** 2)
    assert not found.good
    assert found.size[AT] == pytest.approx(PUSHED * PERIOD_S**2)
    assert found.beyond == 1  # the last tick: what comes after it is not known
    assert not found.sudden[AT:-1].any()


def test_nor_has_one_that_was_struck() -> None:
    """Its speed steps: one large second difference, which nothing takes back."""
    found = seen(STEP * SINCE)
    assert found.beyond == 0
    assert not found.good


def test_a_sound_axis_is_good() -> None:
    found = seen(AXIS.resolution * np.round(np.sin(np.arange(TICKS))))
    assert found.good
    assert found.beyond == 0


def test_drives_in_their_own_time_bring_a_sample_that_is_a_whole_one_late_and_no_step() -> None:
    instants = 2e-3 * np.floor(np.arange(TICKS) * 2.5e-3 / 2e-3)  # of samples every 2 ms, at ticks of 2.5 ms
    speed = np.full(TICKS, 3.0)
    even = in_step(3.0 * instants, speed, instants, 2.5e-3)
    assert np.ptp(np.diff(3.0 * instants)) == pytest.approx(6e-3)
    assert np.ptp(np.diff(even)) < 1e-12
    held = np.arange(TICKS) * 1e-3 + 1e-5 * (np.arange(TICKS) % 2)  # nearly even: left as they are
    assert in_step(even, speed, held, 1e-3) is even
    assert in_step(even, speed, np.zeros(TICKS), 1e-3) is even, "without instants"
