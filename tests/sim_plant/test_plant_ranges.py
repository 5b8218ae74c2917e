"""The ranges of the plant's keys: both ends are taken, and what is beyond them is refused by name."""

import math

import pytest
from pydantic import ValidationError

from sim_plant.config import PlantConfig

RANGES = [
    ("presliding", 0.0, 1.0),
    ("presliding_damping", 0.0, 10.0),
    ("torque_lag", 0.0, 0.1),
    ("torque_noise", 0.0, 1e15),
    ("friction_variation", 0.0, 0.95),
    ("friction_period", 1e-15, 1e15),
    ("friction_phase", -1e3, 1e3),
    ("cable_stiffness", 0.0, 1e15),
    ("cable_hysteresis", 0.0, 1e15),
    ("cable_reach", 1e-15, 1e15),
    ("bias", -1e6, 1e6),
    ("bias_walk", 0.0, 1e15),
    ("backlash", 0.0, 1.0),
    ("drift", -1.0, 1.0),
    ("encoder_noise", 0.0, 1.0),
    ("encoder_periodic_error", 0.0, 1.0),
    ("encoder_period", 1e-15, 1e15),
    ("encoder_latency", 0.0, 1e-3),
]
BASE = {"mass": [0.5, 0.5], "coulomb": [0.3, 0.3], "viscous": [1.0, 1.0], "quadratic": [0.0, 0.0]}


@pytest.mark.parametrize(("key", "low", "high"), RANGES, ids=[name for name, _, _ in RANGES])
def test_the_ends_of_a_range_are_taken_and_nothing_beyond_them(key: str, low: float, high: float) -> None:
    for value in (low, high):
        for one_or_many in (value, [value, value]):
            assert getattr(PlantConfig(**BASE, **{key: one_or_many}), key) == one_or_many
    for value in (math.nextafter(low, -math.inf), math.nextafter(high, math.inf), math.nan, math.inf):
        for one_or_many in (value, [low, value]):
            with pytest.raises(ValidationError, match=key):
                PlantConfig(**BASE, **{key: one_or_many})
