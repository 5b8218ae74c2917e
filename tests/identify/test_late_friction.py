"""How much of the mass that a frequency response shows may be friction that falls with speed."""

import math

import numpy as np
import pytest

from hil.identify.estimate import Estimate
from hil.identify.late_friction import allow_for_late_friction

VISCOUS = 3.0


def test_the_intervals_of_masses_grow_by_what_late_friction_may_be() -> None:
    found = {
        "mass": Estimate(0.9, 1e-3, "kg"), "coulomb": Estimate(0.6, 0.01, "N"), "mode_load": Estimate(0.3, 1e-4, "1"),
        "presliding": Estimate(6e-6, 1e-7, "m"), "mode_damping": Estimate(0.02, 1e-4, "1"),
        "torque_lag": Estimate(2e-4, 1e-6, "s"), "bristle_damping": Estimate(1e-3, 1e-4, "N s"),
    }  # fmt: skip
    kept = dict(found)
    allow_for_late_friction(found, Estimate(1.0, 0.1, "N s/m"), VISCOUS)
    late = 2.0 * np.sqrt(0.9 * 6e-6 / 0.6)  # 2 N s/m late by 3 ms: 6 g
    assert found["mass"].half_width == pytest.approx(np.hypot(1e-3, late))
    assert found["mode_load"].half_width == pytest.approx(np.hypot(1e-4, 0.3 * late / 0.9))
    assert found["mode_damping"].half_width == pytest.approx(np.hypot(1e-4, 2.0 * 0.02 * late / 0.9))
    assert found["torque_lag"].half_width == pytest.approx(np.hypot(1e-6, 2.0 / 0.9 / (200.0 * math.pi) ** 2))
    assert found["bristle_damping"] == kept["bristle_damping"]
    assert found["mass"].value == 0.9
    short = {name: one for name, one in kept.items() if name != "presliding"}
    allow_for_late_friction(short, Estimate(1.0, 0.1, "N s/m"), VISCOUS)
    assert short["mass"] == kept["mass"], "nobody knows the bristle"
