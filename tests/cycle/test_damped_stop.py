"""The damped stop by numbers: its force, and when it is over, at its exact thresholds."""

import math

import pytest

from hil.control.laws.base import Model
from hil.control.nominal_model import rig_model
from hil.cycle.axes import axis_model  # in the compiled build, that of native floats
from hil.cycle.damped_stop import DampedStop
from hil.rig.file import load_rig
from tests.support.paths import RIGS

MS = 1e-3
STOP_S = 0.05
SPEED = [2.0, 0.5]


def models() -> list[Model]:
    """Of two axes, as a rig's cycle has them: what the file calls gravity acts on the axis, the model's holds it."""
    stated = {"x": (0.5, 1.5), "y": (0.25, 0.0)}
    changes = [f"axes.{name}.model.mass={mass}" for name, (mass, _) in stated.items()]
    changes += [f"axes.{name}.model.gravity={gravity}" for name, (_, gravity) in stated.items()]
    whole = rig_model(load_rig(RIGS / "paper.toml", ["task.kind=hold", *changes]))
    return [axis_model(whole, axis) for axis in range(2)]


@pytest.fixture(scope="module")
def stop() -> DampedStop:
    return DampedStop(models(), SPEED, MS, STOP_S)


def test_it_brakes_with_the_mass_over_its_time_constant_and_holds_the_weight(stop: DampedStop) -> None:
    assert stop.force([0.0, 0.0]) == [-1.5, 0.0]
    assert stop.force([0.8, -0.4]) == pytest.approx([-1.5 - 0.5 * 0.8 / 0.008, 0.25 * 0.4 / 0.008], rel=1e-12)


@pytest.mark.parametrize(("period", "constant"), [(1e-4, 0.008), (2e-3, 0.008), (4e-3, 0.016)])
def test_a_slow_loop_brakes_over_four_of_its_periods(period: float, constant: float) -> None:
    force = DampedStop(models(), SPEED, period, STOP_S).force([1.0, 1.0])
    assert force == pytest.approx([-1.5 - 0.5 / constant, -0.25 / constant], rel=1e-12)


@pytest.mark.requirement(id="SR-2.2")
@pytest.mark.parametrize(
    ("velocity", "elapsed", "over"),
    [
        ([0.0, 0.0], 0.2 * STOP_S, True),
        ([0.0, 0.0], math.nextafter(0.2 * STOP_S, 0.0), False),  # a velocity that passes through zero is no rest
        ([1e-3 * 2.0, -1e-3 * 0.5], 0.03, True),
        ([math.nextafter(1e-3 * 2.0, 1.0), 0.0], 0.03, False),
        ([0.0, math.nextafter(-1e-3 * 0.5, -1.0)], 0.03, False),
        ([9.0, 9.0], STOP_S, True),
        ([9.0, 9.0], math.nextafter(STOP_S, 0.0), False),
        ([math.nan, 0.0], 0.03, False),
    ],
)
def test_it_is_over_at_rest_or_when_its_time_is_up(
    stop: DampedStop, velocity: list[float], elapsed: float, over: bool
) -> None:
    assert stop.over(velocity, elapsed) is over
