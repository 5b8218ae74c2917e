"""Friction that is no straight line over speed, from passes written down by formula."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from hil.identify.curved_friction import Line, curved
from hil.identify.estimate import Estimate, Refused, damping
from hil.identify.places import SpeedPass, points_of
from hil.identify.travel_fit import TravelFit, travel_fit

PERIOD = 1e-3
COULOMB, CONSTANT, VISCOUS, FALLS, SCALE = 0.5, -2.4, 3.0, 0.12, 6e-3
SPEEDS = [way * speed for speed in np.geomspace(8e-3, 32e-3, 6) for way in (1.0, -1.0)]
SHAPES = {"rational": lambda u: 1.0 / (1.0 + u * u), "exponential": lambda u: math.exp(-u)}


def one(speed: float, shape: str, falls: float, scale: float = SCALE) -> SpeedPass:
    """Of friction with a part that falls."""
    return passed(speed, lambda v: COULOMB + VISCOUS * v + falls * SHAPES[shape](v / scale))


def passed(speed: float, at_speed: Callable[[float], float], noise: float = 1e-3) -> SpeedPass:
    """From one end of 20 mm to the other, with friction that varies along it. noise: N."""
    n = round(0.02 / abs(speed) / PERIOD)
    x = 0.01 * np.linspace(-1.0, 1.0, n) * math.copysign(1.0, speed)
    moved = at_speed(abs(speed)) + 0.05 * COULOMB * np.sin(2.0 * math.pi * x / 0.006)
    force = math.copysign(1.0, speed) * moved + CONSTANT
    return SpeedPass(force + np.random.default_rng(n).normal(0.0, noise, n), x, speed)


@pytest.mark.long
@pytest.mark.parametrize("shape", sorted(SHAPES))
def test_coulomb_and_viscous_friction_are_told_beside_a_part_that_falls(shape: str) -> None:
    fit = travel_fit([one(speed, shape, FALLS) for speed in SPEEDS], PERIOD, 0.9)
    for name, truth in (("coulomb", COULOMB), ("viscous", VISCOUS)):
        assert fit.found[name].holds(truth), (name, fit.found[name])
        assert fit.found[name].half_width < 0.3 * truth, "it is told, not only bounded"
    falls = fit.curves.curved
    assert falls is not None
    truth = [COULOMB + VISCOUS * abs(v) + FALLS * SHAPES[shape](abs(v) / SCALE) for v in SPEEDS]
    assert fit.curves.friction_at_speed == pytest.approx(np.array(truth), rel=0.01), (
        "the picture shows what was measured"
    )
    assert falls.at(np.array([0.0, 1e-3])) == pytest.approx(falls.at(np.array([8e-3]))[0], rel=0.02), (
        "no slower was seen"
    )
    assert falls.at(np.array([-0.02])) == falls.at(np.array([0.02]))


def told(at_speed: Callable[[float], float], noise: float = 1e-3) -> TravelFit:
    """Of passes with that friction (N) over speed (m/s)."""
    return travel_fit([passed(speed, at_speed, noise) for speed in SPEEDS], PERIOD, 0.9)


@pytest.mark.long
def test_a_straight_line_has_no_such_part() -> None:
    fit = told(lambda v: COULOMB + VISCOUS * v)
    assert fit.curves.curved is None
    for name, truth in (("coulomb", COULOMB), ("viscous", VISCOUS)):
        assert fit.found[name].holds(truth), (name, fit.found[name])
        assert fit.found[name].half_width < 0.05 * truth


@pytest.mark.long
@pytest.mark.parametrize("scale", [4e-3, 8e-3, 16e-3])
def test_friction_that_grows_and_flattens_is_refused_by_name(scale: float) -> None:
    fit = told(lambda v: COULOMB + FALLS * (1.0 - math.exp(-v / scale)))
    for name in ("coulomb", "viscous"):
        assert fit.refused[name].startswith("friction grows with speed and flattens: "), fit.refused
        assert name not in fit.found


@pytest.mark.long
@pytest.mark.parametrize("drag", [40.0, -40.0])
def test_drag_with_the_square_of_speed_is_told_where_nothing_else_explains_it(drag: float) -> None:
    """And where noise hides which it is, no narrow interval is."""
    fit = told(lambda v: COULOMB + VISCOUS * v + drag * v * v, noise=0.0)
    for name, truth in (("coulomb", COULOMB), ("viscous", VISCOUS), ("quadratic", drag)):
        assert fit.found[name].holds(truth), (name, fit.found[name])
        assert fit.found[name].half_width < 0.2 * abs(truth)
    for size in (0.03, 0.1, 0.3, 1.0):
        found = told(lambda v, size=size: COULOMB + VISCOUS * v + size * drag * v * v).found  # type: ignore[misc]
        for name, truth in (("coulomb", COULOMB), ("viscous", VISCOUS)):
            assert name not in found or found[name].holds(truth), (size, name, found[name])


@pytest.mark.long
def test_a_negative_viscous_coefficient_is_refused_by_name() -> None:
    fit = told(lambda v: COULOMB - 1.0 * v)
    assert fit.refused["viscous"].startswith("-0.998 +- ")
    assert "friction falls with speed (at least 0)" in fit.refused["viscous"]
    assert fit.found["coulomb"].holds(COULOMB)
    assert fit.curves.viscous == pytest.approx(-1.0, rel=0.02), "what is drawn and checked is as measured"


def test_what_may_be_no_viscous_friction_is_told_as_none() -> None:
    assert damping(Estimate(-0.1, 0.3, "N s/m")) == Estimate(0.0, 0.4, "N s/m")
    assert damping(Estimate(0.1, 0.3, "N s/m")) == Estimate(0.1, 0.3, "N s/m")
    with pytest.raises(Refused, match=r"-0.4 \+- 0.3 N s/m: friction falls with speed \(at least 0\)"):
        damping(Estimate(-0.4, 0.3, "N s/m"))


@pytest.mark.long
def test_what_the_speeds_do_not_tell_is_refused_by_name() -> None:
    fit = travel_fit([one(speed, "rational", 0.3, 0.02) for speed in SPEEDS], PERIOD, 0.9)
    for name in ("coulomb", "viscous"):
        assert fit.refused[name].startswith("friction falls with speed: ")
        assert "nobody knows it beyond the speeds passed" in fit.refused[name]
        assert "inf" not in fit.refused[name]
        assert name not in fit.found


def test_four_speeds_tell_no_part_that_falls() -> None:
    passes = [one(speed, "rational", FALLS) for speed in SPEEDS[:8]]
    assert curved(points_of(passes, PERIOD, 0.9, 0.0), [p.speed for p in passes]) == Line()
