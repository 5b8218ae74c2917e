"""Friction by direction and forces of the place, from passes written down by formula."""

import math

import numpy as np
import pytest

from hil.identify.estimate import Refused
from hil.identify.travel_fit import SpeedPass, travel_fit

PERIOD = 1e-3
COULOMB, CONSTANT, VISCOUS, STIFFNESS = 0.5, -2.4, 3.0, 0.1


def one(speed: float, waves: bool, noise: float = 1e-3) -> SpeedPass:
    """From one end of 30 mm to the other."""
    n = round(0.03 / abs(speed) / PERIOD)
    x = 0.015 * np.linspace(-1.0, 1.0, n) * math.copysign(1.0, speed)
    friction = COULOMB * (1.0 + 0.1 * waves * np.sin(2.0 * math.pi * x / 0.009 + 1.0))
    place = 0.03 * waves * np.cos(2.0 * math.pi * x / 0.024)
    force = math.copysign(1.0, speed) * friction + place + CONSTANT + VISCOUS * speed + STIFFNESS * x
    return SpeedPass(force + np.random.default_rng(n).normal(0.0, noise, n), x, speed)


SPEEDS = (0.01, -0.01, 0.02, -0.02, 0.04, -0.04)


def test_friction_and_what_varies_along_the_travel() -> None:
    found = travel_fit([one(speed, waves=True) for speed in SPEEDS], PERIOD, 0.9).found
    turns = 2.0 * math.pi * 0.0147 / 0.009
    mean = COULOMB * (1.0 + 0.1 * math.sin(1.0) * math.sin(turns) / turns)  # over the travel
    for name, truth, within in (
        ("coulomb", mean, 0.002), ("constant", CONSTANT, 0.005), ("viscous", VISCOUS, 0.05),
        ("friction_variation", 0.1, 0.05), ("friction_period", 0.009, 0.01),
        ("cogging_amplitude", 0.03, 0.1), ("cogging_period", 0.024, 0.02),
    ):  # fmt: skip
        assert found[name].value == pytest.approx(truth, rel=within), name
    assert found["coulomb"].holds(mean)


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
