"""At what frequency a loop rings: told where one does, and not of noise, a runaway, a push, or a task that swings."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.events.event import Event
from hil.events.ringing import LONGEST, ringing_hz
from hil.rig.file import load_rig
from hil.virtual.sim import simulate
from tests.support.paths import RIGS, ROOT

PERIOD, COUNT = 1e-3, 5e-9
TICKS = np.arange(LONGEST + 1)
FLAT = np.zeros(len(TICKS))
STAGE = f"plant.stage={ROOT}/tests/support/two_resonances.py:TwoResonances"
TASK = [
    "task.kind=circle", "task.axes=['x','y']", "task.radius=0.005", "task.approach_s=0.3", "task.settle_s=0.1",
    "drives.brake_opening_s=0",  # Z only stands
]  # fmt: skip


def told(error: NDArray[np.float64], force: NDArray[np.float64], setpoint: NDArray[np.float64] = FLAT) -> float | None:
    return ringing_hz(error, force, setpoint, COUNT, PERIOD)


def swing(frequency: float, growth: float = 0.0) -> NDArray[np.float64]:
    """Up to 1 at the end, times e in so many ticks."""
    found: NDArray[np.float64] = np.sin(2.0 * np.pi * frequency * PERIOD * TICKS) * np.exp(growth * (TICKS - LONGEST))
    return found


@pytest.mark.parametrize("growth", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("frequency", [30.0, 57.0, 121.0, 197.0, 333.0, 470.0])
def test_a_swing_that_does_not_fade_is_told_by_its_frequency(frequency: float, growth: float) -> None:
    noise = np.random.default_rng(5).normal(0.0, COUNT, (2, len(TICKS)))
    error = 1e-4 * swing(frequency, growth) + 2e-7 * TICKS + noise[0]
    found = told(error, 8.0 * np.clip(3.0 * swing(frequency, growth), -1.0, 1.0) + noise[1])
    if frequency < 50.0 and growth >= 0.05:
        assert found is None, "less than two periods, of which the last is nearly all"
    else:
        assert found == pytest.approx(frequency, rel=0.03, abs=2.0)


def test_six_hertz_are_told_and_what_fades_is_not() -> None:
    assert told(1e-4 * swing(8.0), swing(8.0)) == pytest.approx(8.0, abs=0.5)
    assert told(1e-4 * swing(120.0, -0.01), swing(120.0, -0.01)) is None


@pytest.mark.parametrize("seed", range(20))
def test_noise_is_no_ringing(seed: int) -> None:
    draw = np.random.default_rng(seed)
    error = draw.normal(0.0, 1e-5, len(TICKS))
    assert told(error, 1e5 * np.diff(error, prepend=0.0)) is None
    assert told(error, np.convolve(error, np.ones(4), "same")) is None


def test_a_runaway_a_push_and_a_step_are_no_ringing() -> None:
    away = np.exp(0.03 * (TICKS - LONGEST))
    assert told(1e-3 * away, -15.0 * away) is None
    push = np.maximum(0, TICKS - LONGEST + 20) ** 2.0
    assert told(1e-6 * push, -0.04 * push) is None
    step = (TICKS > LONGEST - 12).astype(float)
    assert told(1e-4 * step, -step * np.exp(-0.2 * (TICKS - LONGEST))) is None


def test_a_swing_without_force_or_of_the_task_itself_is_not_the_loops() -> None:
    assert told(1e-4 * swing(120.0), np.full(len(TICKS), 3.0)) is None
    assert told(1e-4 * swing(120.0), swing(120.0), 3e-4 * swing(120.0)) is None
    assert told(1e-4 * swing(120.0), swing(120.0), 3e-4 * swing(20.0)) == pytest.approx(120.0, abs=2.0)
    assert told(2.0 * COUNT * swing(120.0), swing(120.0)) is None, "two counts"


def latched(*overrides: str) -> Event:
    rig = load_rig(RIGS / "microscope.toml", [STAGE, *TASK, *overrides])
    report, _ = simulate(rig, Path(RIGS), 1.0)
    assert report.latched is not None
    return report.latched


def second(frequency: float, sign: float = 1.0) -> str:
    """The resonance of the model, and another."""
    return f"plant.parameters={{frequencies=[196.0, {frequency}], loads=[0.25, 0.12], sign={sign}}}"


@pytest.mark.long
@pytest.mark.parametrize(
    ("frequency", "fault", "least", "most"), [(240.0, "oscillation", 260, 290), (280.0, "speed", 300, 330)]
)
def test_a_stage_that_rings_on_a_second_resonance(frequency: float, fault: str, least: int, most: int) -> None:
    """It is free at 1.07 times the frequency at which the motor is held, and the loop moves it a little."""
    event = latched(second(frequency))
    assert (event.name, event.axis) == (fault, "x")
    words = event.cause.split()
    assert words[:2] == ["rings", "at"]
    assert words[3] == "Hz:"
    assert least <= int(words[2]) <= most


@pytest.mark.long
@pytest.mark.parametrize(("error", "fault"), [(0.01, "speed"), (1e-4, "following_error")])
def test_a_drive_that_pushes_the_wrong_way_neither_rings_nor_was_it_pushed(error: float, fault: str) -> None:
    event = latched(second(280.0, sign=-1.0), f"axes.x.limits.following_error={error}")
    assert (event.name, event.axis) == (fault, "x")
    assert event.cause == "the axis goes against the force asked for: wrong direction of axis or drive"
    assert "axes.x.direction" in event.action
