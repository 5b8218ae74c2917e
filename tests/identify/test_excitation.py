"""The law of an experiment, closed around a stage that this package's tests integrate themselves."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.control.laws.base import Model
from hil.identify.excitation import GROWING, MULTISINE, Excitation, multisine_lines, multisine_motion
from tests.identify.stages import PERIOD, Bristle, Coulomb, record

MASS, COULOMB, WEIGHT, FROM_S = 0.25, 0.2, 2.45, 1.5


def law(**gains: float) -> Excitation:
    model = Model(mass=MASS, coulomb=0.0, viscous=0.0, quadratic=0.0, gravity=0.0)
    return Excitation(model, PERIOD, 10.0, **gains)


def at_rest(one: Excitation) -> Any:
    """The law on a reference that stands still, as stages.record asks."""
    still = SimpleNamespace(position=0.0, velocity=0.0)

    def asked(seconds: float, position: float, speed: float) -> float:
        inputs: Any = SimpleNamespace(
            start=still, position_estimate=position, velocity_estimate=speed, position=position,
            task_ns=round(seconds * 1e9), mean_acceleration=0.0, mean_velocity=0.0, mean_sign=0.0,
        )  # fmt: skip
        return float(one.force(inputs))

    return asked


@pytest.mark.parametrize("share", [0.7, 1.3])
def test_a_push_finds_the_middle_of_the_friction_of_an_axis_whose_weight_is_30_percent_off(share: float) -> None:
    one = law(gravity=share * WEIGHT, shape=GROWING, amplitude=0.02, from_s=FROM_S, until_s=FROM_S + 6.0, hold_hz=25.0)
    force, position = record(Bristle(COULOMB, 5e-6, 10.0), at_rest(one), FROM_S + 6.5, MASS, 1.2, WEIGHT)
    pushed = slice(round(FROM_S / PERIOD), round((FROM_S + 6.0) / PERIOD))
    assert np.abs(position).max() < 200e-6, "the following error may be 300 um"
    assert np.ptp(position[pushed]) > 20e-6
    ends = np.array([force[pushed].min(), force[pushed].max()])
    assert ends.mean() == pytest.approx(WEIGHT, abs=0.5 * COULOMB)


def test_friction_fed_forward_turns_within_its_way() -> None:
    one = law(excursion=20e-6)
    there = [one._friction(2e-3) for _ in range(100)]  # 200 um: ten times the way
    back = [one._friction(-2e-3) for _ in range(100)]
    assert there[-1] == pytest.approx(1.0, abs=1e-3)
    assert back[4] == pytest.approx(2.0 * math.exp(-0.5) - 1.0, abs=0.05), "10 um after the reversal"
    assert back[-1] == pytest.approx(-1.0, abs=1e-3)


def test_the_loop_is_filtered_where_an_unknown_resonance_may_be() -> None:
    def passed(hertz: float) -> float:
        one = law()
        out = [one._filtered(math.sin(2.0 * math.pi * hertz * k * PERIOD)) for k in range(1000)]
        return float(max(out[500:]))

    assert passed(10.0) == pytest.approx(1.0, abs=0.1)
    assert passed(150.0) < 0.35


def test_the_way_and_the_speed_of_a_multisine_are_those_of_a_mass_in_the_loop() -> None:
    asked = at_rest(law(shape=MULTISINE, amplitude=0.01, until_s=4.0))
    _, position = record(Coulomb(0.0), asked, 3.0, MASS, 0.0)
    swing, speed = position[1000:], np.diff(position[1000:]) / PERIOD
    way, peak = multisine_motion(MASS)
    assert float(np.std(swing)) == pytest.approx(0.01 * way, rel=0.05)
    assert float(np.abs(speed).max()) == pytest.approx(0.01 * peak, rel=0.05)


@pytest.mark.parametrize("begins", [0.0, 5e-3])
@pytest.mark.parametrize("held", [0.0, 0.9, -0.9])
def test_a_push_finds_both_ends_of_friction_wherever_it_begins(begins: float, held: float) -> None:
    """held: of Coulomb friction, what the axis rests on; the smallest triangle moves one that rests on an end."""
    one = law(shape=GROWING, amplitude=0.01, from_s=0.0, until_s=9.0)
    one.reset(begins, 0.0)  # the approach comes before the push
    asked = at_rest(one)
    force, position = record(
        Bristle(COULOMB, 1e-6, 10.0), lambda t, x, v: asked(t, x, v) + held * COULOMB, 9.0, MASS, 1.2
    )
    ends = np.flatnonzero(np.abs(np.diff(force)) > 1e-3)
    assert (force.max() - force.min()) / 2.0 == pytest.approx(1.1 * COULOMB, rel=0.25)
    assert np.ptp(position) < 160e-6
    assert ends[-1] < 8000, "it is over, and its force stays"


@pytest.mark.parametrize("held", [1.0, -1.0])
def test_an_axis_that_rests_on_one_end_of_soft_friction_does_not_creep_along_it(held: float) -> None:
    """The other end is twice Coulomb friction away, and it takes many triangles to get there."""
    one = law(mass=0.5 * MASS, shape=GROWING, amplitude=0.02, from_s=0.0, until_s=9.0)
    asked = at_rest(one)
    force, position = record(
        Bristle(COULOMB, 14e-6, 10.0), lambda t, x, v: asked(t, x, v) + held * COULOMB, 9.0, MASS, 1.2
    )
    assert (force.max() - force.min()) / 2.0 == pytest.approx(1.1 * COULOMB, rel=0.25)
    assert np.abs(position).max() < 130e-6


def test_the_loop_is_stable_at_slow_rates() -> None:
    slow = Excitation(Model(mass=MASS, coulomb=0.0, viscous=0.0, quadratic=0.0, gravity=0.0), 2.5e-3, 10.0)
    passed = [slow._filtered(1.0) for _ in range(200)]
    assert max(passed) < 1.2
    assert passed[-1] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(("period", "last", "count"), [(1e-3, 480.0, 108), (5e-4, 480.0, 108), (2.5e-3, 80.0, 20)])
def test_a_multisine_stays_below_half_of_the_rate(period: float, last: float, count: int) -> None:
    lines = multisine_lines(period)
    assert (len(lines), lines[-1] / 0.5) == (count, last)
    assert np.diff(lines).min() >= 2
