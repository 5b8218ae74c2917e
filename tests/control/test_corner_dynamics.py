"""A corner's axis, number by number: what slides is off by its factors, what is stuck hangs on a damped spring."""

import math

import pytest

from hil.control.loop_corners import STUCK_DAMPING, Corner
from hil.rig.tables import ModelConfig

MODEL = ModelConfig(
    mass=2.0, coulomb=0.5, viscous=3.0, torque_lag=2e-4, mode_frequency_hz=150.0, mode_damping=0.02, mode_load=0.3,
    presliding=[1e-6, 1e-4],
)  # fmt: skip


def test_a_sliding_corner_is_off_by_its_factors_alone() -> None:
    axis = Corner(mass=1.2, mode=0.9, lag=0.8, friction=0.7).dynamics(MODEL)
    assert axis is not None
    assert (axis.mass, axis.lag, axis.mode_hz) == (pytest.approx(2.4), pytest.approx(1.6e-4), pytest.approx(135.0))
    assert (axis.mode_damping, axis.mode_load, axis.viscous) == (0.02, 0.3, pytest.approx(2.1))
    assert (axis.stiffness, axis.damping) == (0.0, 0.0)


@pytest.mark.parametrize(("share", "distance"), [(0.0, 1e-6), (0.5, 1e-5), (1.0, 1e-4)])
def test_a_stuck_corner_hangs_on_its_friction_with_the_least_damping(share: float, distance: float) -> None:
    axis = Corner(mass=0.8, friction=1.3, stuck=share).dynamics(MODEL)
    assert axis is not None
    assert axis.viscous == 0.0
    assert axis.stiffness == pytest.approx(1.3 * 0.5 / distance)
    assert axis.damping / (2.0 * math.sqrt(axis.stiffness * 1.6)) == pytest.approx(STUCK_DAMPING)


def test_a_stage_without_stiction_has_no_stuck_corner() -> None:
    assert Corner(stuck=0.5).dynamics(MODEL.model_copy(update={"presliding": []})) is None
    assert Corner(stuck=0.5).dynamics(MODEL.model_copy(update={"coulomb": 0.0})) is None
