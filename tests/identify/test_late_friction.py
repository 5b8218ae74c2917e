"""How much of the mass that a frequency response shows may be friction that falls with speed."""

import numpy as np
import pytest

from hil.identify.estimate import Estimate
from hil.identify.late_friction import allow_for_late_friction, viscous_beside

VISCOUS, FALLS, HALF = 3.0, 0.15, 6e-3
SPEED = np.repeat(np.geomspace(8e-3, 32e-3, 6), 2)


def friction(falls: float) -> np.ndarray:
    noise = 1e-4 * np.random.default_rng(1).normal(size=SPEED.size)
    return 0.6 + VISCOUS * SPEED + falls / (1.0 + (SPEED / HALF) ** 2) + noise


def test_viscous_friction_is_told_beside_friction_that_falls_with_speed() -> None:
    assert viscous_beside(SPEED, friction(FALLS)) == pytest.approx(VISCOUS, rel=0.05)
    assert viscous_beside(-SPEED, friction(FALLS)) == pytest.approx(VISCOUS, rel=0.05)


def test_a_straight_line_has_none_and_neither_has_friction_that_grows() -> None:
    assert viscous_beside(SPEED, friction(0.0)) is None
    assert viscous_beside(SPEED, friction(-FALLS)) is None


def test_the_intervals_of_masses_grow_by_what_late_friction_may_be() -> None:
    found = {
        "mass": Estimate(0.9, 1e-3, "kg"), "coulomb": Estimate(0.6, 0.01, "N"), "mode_load": Estimate(0.3, 1e-4, "1"),
        "presliding": Estimate(6e-6, 1e-7, "m"), "mode_damping": Estimate(0.02, 1e-4, "1"),
    }  # fmt: skip
    kept = dict(found)
    allow_for_late_friction(found, Estimate(1.0, 0.1, "N s/m"), VISCOUS)
    late = 2.0 * np.sqrt(0.9 * 6e-6 / 0.6)  # 2 N s/m late by 3 ms: 6 g
    assert found["mass"].half_width == pytest.approx(np.hypot(1e-3, late))
    assert found["mode_load"].half_width == pytest.approx(np.hypot(1e-4, 0.3 * late / 0.9))
    assert found["mode_damping"] == kept["mode_damping"]
    assert found["mass"].value == 0.9
    short = {name: one for name, one in kept.items() if name != "presliding"}
    allow_for_late_friction(short, Estimate(1.0, 0.1, "N s/m"), VISCOUS)
    assert short["mass"] == kept["mass"], "nobody knows the bristle"
