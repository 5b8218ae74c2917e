"""Friction that falls with speed beside Coulomb and viscous friction, from passes written down by formula."""

import math

import numpy as np
import pytest

from hil.identify.falling_friction import falling
from hil.identify.places import SpeedPass, points_of
from hil.identify.travel_fit import travel_fit

PERIOD = 1e-3
COULOMB, CONSTANT, VISCOUS, FALLS, SCALE = 0.5, -2.4, 3.0, 0.12, 6e-3
SPEEDS = [way * speed for speed in np.geomspace(8e-3, 32e-3, 6) for way in (1.0, -1.0)]
SHAPES = {"rational": lambda u: 1.0 / (1.0 + u * u), "exponential": lambda u: math.exp(-u)}


def one(speed: float, shape: str, falls: float, scale: float = SCALE) -> SpeedPass:
    """From one end of 20 mm to the other, with friction that varies along it."""
    n = round(0.02 / abs(speed) / PERIOD)
    x = 0.01 * np.linspace(-1.0, 1.0, n) * math.copysign(1.0, speed)
    moved = COULOMB * (1.0 + 0.05 * np.sin(2.0 * math.pi * x / 0.006)) + falls * SHAPES[shape](abs(speed) / scale)
    force = math.copysign(1.0, speed) * moved + CONSTANT + VISCOUS * speed
    return SpeedPass(force + np.random.default_rng(n).normal(0.0, 1e-3, n), x, speed)


@pytest.mark.long
@pytest.mark.parametrize("shape", sorted(SHAPES))
def test_coulomb_and_viscous_friction_are_told_beside_a_part_that_falls(shape: str) -> None:
    fit = travel_fit([one(speed, shape, FALLS) for speed in SPEEDS], PERIOD, 0.9)
    for name, truth in (("coulomb", COULOMB), ("viscous", VISCOUS)):
        assert fit.found[name].holds(truth), (name, fit.found[name])
        assert fit.found[name].half_width < 0.3 * truth, "it is told, not only bounded"
    falls = fit.curves.falls
    assert falls is not None
    truth = [COULOMB + VISCOUS * abs(v) + FALLS * SHAPES[shape](abs(v) / SCALE) for v in SPEEDS]
    assert fit.curves.friction_at_speed == pytest.approx(np.array(truth), rel=0.01), (
        "the picture shows what was measured"
    )
    assert falls.at(np.array([0.0, 1e-3])) == pytest.approx(falls.at(np.array([8e-3]))[0], rel=0.02), (
        "no slower was seen"
    )
    assert falls.at(np.array([-0.02])) == falls.at(np.array([0.02]))


@pytest.mark.long
@pytest.mark.parametrize("falls", [0.0, -FALLS])
def test_a_straight_line_and_friction_that_grows_have_no_such_part(falls: float) -> None:
    fit = travel_fit([one(speed, "rational", falls) for speed in SPEEDS], PERIOD, 0.9)
    assert fit.curves.falls is None
    if not falls:
        assert fit.found["viscous"].holds(VISCOUS)


@pytest.mark.long
def test_what_the_speeds_do_not_tell_is_refused_by_name() -> None:
    fit = travel_fit([one(speed, "rational", 0.3, 0.02) for speed in SPEEDS], PERIOD, 0.9)
    for name in ("coulomb", "viscous"):
        assert fit.refused[name].startswith("friction falls with speed: ")
        assert "it may fall on beyond the speeds passed" in fit.refused[name]
        assert "inf" not in fit.refused[name]
        assert name not in fit.found


def test_four_speeds_tell_no_part_that_falls() -> None:
    passes = [one(speed, "rational", FALLS) for speed in SPEEDS[:8]]
    assert falling(points_of(passes, PERIOD, 0.9, 0.0), [p.speed for p in passes]) is None
