"""Friction by direction and forces of the place, from passes written down by formula."""

import math

import numpy as np
import pytest

from hil.identify.estimate import Estimate, Refused
from hil.identify.places import SpeedPass, points_of, seen
from hil.identify.travel_fit import travel_fit
from hil.identify.waves import within_travel

PERIOD = 1e-3
COULOMB, CONSTANT, VISCOUS, STIFFNESS = 0.5, -2.4, 3.0, 0.1


def one(speed: float, waves: bool, noise: float = 1e-3, length: float = 0.009) -> SpeedPass:
    """From one end of 30 mm to the other."""
    n = round(0.03 / abs(speed) / PERIOD)
    x = 0.015 * np.linspace(-1.0, 1.0, n) * math.copysign(1.0, speed)
    there = x + 0.5 * speed * PERIOD  # where a force is meant, which is held from a sample to the next
    friction = COULOMB * (1.0 + 0.1 * waves * np.sin(2.0 * math.pi * there / length + 1.0))
    place = 0.03 * waves * np.cos(2.0 * math.pi * there / 0.024)
    force = math.copysign(1.0, speed) * friction + place + CONSTANT + VISCOUS * speed + STIFFNESS * there
    return SpeedPass(force + np.random.default_rng(n).normal(0.0, noise, n), x, speed)


SPEEDS = (0.01, -0.01, 0.02, -0.02, 0.04, -0.04)


def test_friction_and_what_varies_along_the_travel() -> None:
    found = travel_fit([one(speed, waves=True) for speed in SPEEDS], PERIOD, 0.9).found
    turns = 2.0 * math.pi * 0.0147 / 0.009
    mean = COULOMB * (1.0 + 0.1 * math.sin(1.0) * math.sin(turns) / turns)  # over the travel
    for name, truth, within in (
        ("coulomb", mean, 0.002), ("constant", CONSTANT, 0.005), ("viscous", VISCOUS, 0.05),
        ("friction_variation", 0.1, 0.05), ("friction_period", 0.009, 0.01),
        ("cogging_amplitude", 0.03, 0.1), ("cogging_period", 0.024, 0.02), ("friction_phase", 1.0, 0.02),
        ("cogging_phase", 0.5 * math.pi, 0.05),
    ):  # fmt: skip
        assert found[name].value == pytest.approx(truth, rel=within), name
    assert found["coulomb"].holds(mean)


@pytest.mark.parametrize("length", [0.6e-3, 1e-3, 1.9e-3])
def test_friction_of_rolling_elements_that_pass(length: float) -> None:
    """At 40 mm/s the filter leaves nothing of 0.6 mm, at 10 mm/s nearly all."""
    fit = travel_fit([one(speed, waves=True, length=length) for speed in SPEEDS], PERIOD, 0.9)
    assert fit.found["friction_period"].value == pytest.approx(length, rel=1e-3)
    assert fit.found["friction_variation"].value == pytest.approx(0.1, rel=0.05)
    assert fit.found["friction_phase"].value == pytest.approx(1.0, abs=0.05)
    assert fit.found["cogging_period"].value == pytest.approx(0.024, rel=0.02)
    truth = COULOMB * (1.0 + 0.1 * np.sin(2.0 * math.pi * fit.curves.position / length + 1.0))
    assert np.abs(fit.curves.friction - truth).max() < 0.2 * 0.1 * COULOMB, "curves show what the filter hid"


def shaken(speed: float, loop_hz: float = 10.0) -> SpeedPass:
    """Of a light axis in a loose loop: friction that passes at 10 to 40 Hz shakes it. A step of Euler's a tick is
    exact, as the force is that of the ticks.
    """
    mass, n = 0.02, round(0.03 / abs(speed) / PERIOD)
    way, turn = math.copysign(1.0, speed), 2.0 * math.pi * loop_hz
    x, v, positions, forces = -0.015 * way, speed, [], []
    for k in range(n):
        error, rate = -0.015 * way + speed * k * PERIOD - x, speed - v
        friction = way * COULOMB * (1.0 + 0.1 * math.sin(2.0 * math.pi * x / 1e-3)) + VISCOUS * v
        force = mass * (turn * turn * error + 1.6 * turn * rate) + way * COULOMB + VISCOUS * speed
        positions.append(x)
        forces.append(force)
        x += PERIOD * v + 0.5 * PERIOD**2 * (force - friction) / mass
        v += PERIOD * (force - friction) / mass
    return SpeedPass(np.array(forces), np.array(positions), speed)


def test_friction_that_shakes_a_loose_axis_is_told_as_that_of_a_stiff_one() -> None:
    """It is slow where friction is great: viscous friction was 4 % off, Coulomb friction 0.2 %, the variation 5 %."""
    fit = travel_fit([shaken(speed) for speed in SPEEDS], PERIOD, 0.02)
    assert fit.found["viscous"].value == pytest.approx(VISCOUS, rel=0.01)
    assert fit.found["coulomb"].value == pytest.approx(COULOMB, rel=1e-3)
    assert fit.found["friction_variation"].value == pytest.approx(0.1, rel=0.02)


def test_waves_longer_than_the_travel_are_no_shaking() -> None:
    """Nobody knows how large they are: taken out as if they were known, they grew to kilonewtons."""
    waves, x = [(True, 0.02), (False, 0.05), (False, 0.01)], np.arange(9.0)
    kept, weights = within_travel(waves, x, 0.03)
    assert kept == [(True, 0.02), (False, 0.01)]
    assert weights.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 7.0, 8.0]
    assert within_travel(waves[1:2], x[:5], 0.03)[0] == []


def test_friction_that_varies_makes_no_cogging_of_its_period() -> None:
    """Half a period's way is 20 um at 40 mm/s: forces that counted at their beginning made a wave of the place."""
    fit = travel_fit([one(speed, waves=True, noise=0.0, length=0.003) for speed in SPEEDS], PERIOD, 0.9)
    x = fit.curves.position
    rest = fit.curves.place - 0.03 * np.cos(2.0 * math.pi * x / 0.024) - CONSTANT - STIFFNESS * x
    assert 2.0 * abs((rest * np.exp(2j * math.pi * x / 0.003)).mean()) < 0.002 * 0.1 * COULOMB


def test_a_plain_guide_has_no_waves() -> None:
    fit = travel_fit([one(speed, waves=False) for speed in SPEEDS], PERIOD, 0.9)
    assert fit.found["coulomb"].holds(COULOMB)
    assert set(fit.refused) == {"friction_variation", "cogging_amplitude"}


def test_one_speed_tells_no_viscous_friction() -> None:
    fit = travel_fit([one(speed, waves=False) for speed in (0.01, -0.01, 0.01, -0.01)], PERIOD, 0.9)
    assert "at least two" in fit.refused["viscous"]


def test_a_period_beyond_the_travel_is_not_told() -> None:
    passes = []
    for speed in SPEEDS:
        plain = one(speed, waves=False)
        slope = 0.1 * COULOMB * np.sin(2.0 * math.pi * plain.position / 0.06)
        passes.append(plain._replace(force=plain.force + math.copysign(1.0, speed) * slope))
    fit = travel_fit(passes, PERIOD, 0.9)
    assert "longer than the travel" in fit.refused["friction_variation"]
    assert "friction_period" not in fit.found
    assert fit.found["coulomb"].value == pytest.approx(COULOMB, rel=0.005)


def test_two_long_periods_are_told_apart() -> None:
    """One after the other, the first was fitted to both, and the second to what was left."""
    passes = []
    for speed in SPEEDS:
        plain, way = one(speed, waves=False), math.copysign(1.0, speed)
        x = plain.position
        friction = 0.05 * way * np.sin(2.0 * math.pi * x / 0.0195 + 3.5)
        passes.append(plain._replace(force=plain.force + friction + 0.02 * np.sin(2.0 * math.pi * x / 0.024 + 2.0)))
    found = travel_fit(passes, PERIOD, 0.9).found
    assert found["friction_period"].value == pytest.approx(0.0195, rel=0.01)
    assert found["cogging_period"].value == pytest.approx(0.024, rel=0.02)
    assert found["cogging_amplitude"].value == pytest.approx(0.02, rel=0.05)


def test_a_scale_that_slips_is_seen_by_what_lies_along_the_travel() -> None:
    """Positions that are told 0.2 mm too far in the last pass, also while the friction grows; nothing tells it on a
    guide that is everywhere alike.
    """

    def drift(by: float, waves: bool = True, warmer: float = 0.0) -> Estimate | None:
        passes = []
        for number, speed in enumerate(SPEEDS):
            part, plain = number / (len(SPEEDS) - 1), one(speed, waves)
            force = plain.force + math.copysign(part * warmer, speed)
            passes.append(plain._replace(position=plain.position + part * by, force=force))
        return travel_fit(passes, PERIOD, 0.9).found.get("position_drift")

    for by, warmer in ((2e-4, 0.0), (-2e-4, 0.01), (0.0, 0.01)):
        found = drift(by, warmer=warmer)
        assert found is not None
        assert found.holds(by)
        assert found.value == pytest.approx(by, rel=0.05, abs=1e-5)
        assert found.half_width < 0.5 * abs(by) + 3e-5
    assert drift(2e-4, waves=False) is None


def test_places_passed_in_a_stall_do_not_count() -> None:
    passes = [one(speed, waves=False) for speed in SPEEDS]
    force = passes[0].force.copy()
    force[1500:1600] += 2.0  # what a loop does that was blind for a while
    stalled = passes[0]._replace(force=force, stalled=[1500, 1501, 1502])
    found = travel_fit([stalled, *passes[1:]], PERIOD, 0.9).found
    assert found["coulomb"].value == pytest.approx(COULOMB, rel=1e-3)
    with pytest.raises(Refused, match="left unexplained"):
        travel_fit([stalled._replace(stalled=()), *passes[1:]], PERIOD, 0.9)


def test_forces_that_frames_round_are_no_better_known_than_a_step() -> None:
    passes = [one(speed, waves=False) for speed in SPEEDS]
    fine, coarse = travel_fit(passes, PERIOD, 0.9), travel_fit(passes, PERIOD, 0.9, rounding=0.015)
    assert fine.found["coulomb"].half_width < 0.002
    assert coarse.found["coulomb"].half_width == pytest.approx(0.015, rel=0.05)
    assert coarse.found["viscous"].half_width == pytest.approx(0.015 / 0.03, rel=0.05)
    assert fine.found == travel_fit(passes, PERIOD, 0.9, rounding=1e-6).found, "noise carries the force over the steps"


def test_a_pass_that_is_over_at_once_is_refused() -> None:
    short = one(0.04, waves=False)._replace(force=np.zeros(20), position=np.linspace(0.0, 8e-4, 20))
    with pytest.raises(Refused, match="at constant speed for"):
        travel_fit([one(speed, waves=False) for speed in SPEEDS] + [short], PERIOD, 0.9)


def test_one_direction_cannot_tell_friction_from_weight() -> None:
    with pytest.raises(Refused, match="4 and 0 passes"):
        travel_fit([one(0.01, waves=False)] * 4, PERIOD, 0.9)


def test_a_force_that_fits_nothing_is_refused() -> None:
    with pytest.raises(Refused, match="left unexplained"):
        travel_fit([one(speed, waves=False, noise=3.0) for speed in SPEEDS], PERIOD, 0.9)


def test_a_wave_that_no_place_shows_is_not_told() -> None:
    """Of periods far below a place's width the search sees nothing, and must not divide by it."""
    fit = travel_fit([one(speed, waves=True, length=2e-5) for speed in SPEEDS], PERIOD, 0.9)
    assert fit.found["cogging_period"].value == pytest.approx(0.024, rel=0.1)
    assert fit.found["coulomb"].holds(COULOMB)
    points = points_of([one(speed, waves=True) for speed in SPEEDS], PERIOD, 0.9, 0.0)
    assert not seen(points, 1e-5).any()
    assert seen(points, 1e-3).any()
