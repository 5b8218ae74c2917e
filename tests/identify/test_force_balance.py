"""What the balance finds of stages that other code integrated, and what it refuses."""

import math

import numpy as np
import pytest

from hil.identify.estimate import Refused
from hil.identify.force_balance import Record, balance, bristle, lagged, played
from tests.identify.stages import PERIOD, Bristle, MaxwellSlip, record


def shrinking(size: float, hertz: float, seconds: float) -> "object":
    """Triangles of force, the last a tenth of the first, on a loose spring."""

    def asked(t: float, x: float, v: float) -> float:
        part = t * hertz % 1.0
        wave = 4.0 * part if part < 0.25 else 2.0 - 4.0 * part if part < 0.75 else 4.0 * part - 4.0
        return size * (1.0 - 0.9 * t / seconds) * wave - 300.0 * x - 20.0 * v

    return asked


@pytest.mark.parametrize("length", [1e-6, 10e-6])
def test_presliding_and_coulomb_of_a_bristle(length: float) -> None:
    force, position = record(Bristle(0.6, length, 30.0), shrinking(0.8, 4.0, 2.5), 2.5)  # type: ignore[arg-type]
    found = balance([Record(force, position, PERIOD, 5e-9, skip=300)], mass=0.9, viscous=3.0).found
    assert found["presliding"].value == pytest.approx(length, rel=0.1)
    assert found["presliding"].holds(length)
    assert found["coulomb"].value == pytest.approx(0.6, rel=0.03)


def test_mass_and_friction_of_an_ordinary_motion() -> None:
    def follow(t: float, x: float, v: float) -> float:
        w = 2.0 * math.pi * 2.0
        return 5000.0 * (2e-3 * math.sin(w * t) - x) + 100.0 * (2e-3 * w * math.cos(w * t) - v)

    force, position = record(Bristle(0.3, 5e-6, 20.0), follow, 2.0, mass=1.7, viscous=2.0, constant=0.4)
    found = balance([Record(force, position, PERIOD, 5e-9, skip=100)]).found
    for name, truth in (("mass", 1.7), ("coulomb", 0.3), ("constant", 0.4)):
        assert found[name].value == pytest.approx(truth, rel=0.05), name
        assert found[name].holds(truth), name


def test_a_stage_of_many_elements_is_not_one_bristle() -> None:
    limits = np.full(6, 0.1)
    stage = MaxwellSlip(limits, limits / np.geomspace(0.2e-6, 200e-6, 6))
    force, position = record(stage, shrinking(0.8, 4.0, 2.5), 2.5)  # type: ignore[arg-type]
    with pytest.raises(Refused, match="unexplained"):
        balance([Record(force, position, PERIOD, 5e-9, skip=300)], mass=0.9, viscous=3.0)


def test_an_axis_at_rest_tells_nothing() -> None:
    with pytest.raises(Refused, match="not enough motion: 3 encoder counts"):
        balance([Record(np.zeros(500), np.linspace(0.0, 15e-9, 500), PERIOD, 5e-9)])


def test_the_bristle_is_the_differential_equation() -> None:
    path = np.cumsum(np.random.default_rng(1).normal(0.0, 1e-7, 400)) + 1e-6 * np.sin(np.arange(400) / 30)
    state, slow = 0.0, []
    for move in np.diff(path, prepend=path[0]):
        for _ in range(200):
            state += move / 200 / 2e-6 - abs(move) / 200 / 2e-6 * state
        slow.append(state)
    assert bristle(path, 2e-6) == pytest.approx(slow, abs=2e-3)


def test_play_keeps_noise_from_the_bristle() -> None:
    assert played(np.array([0.0, 1.0, -1.0, 5.0, 4.0, 2.0]), 1.0).tolist() == [0.0, 0.0, 0.0, 4.0, 4.0, 3.0]


def test_a_lag_delays_a_step_of_force() -> None:
    step = np.r_[np.zeros(5), np.ones(5)]
    after = lagged(step, 1e-3, 1e-3)
    exact = [1.0 - math.exp(-k) * (1.0 - math.exp(-1.0)) for k in range(5)]
    assert after[5:] == pytest.approx(exact)


def test_a_force_that_never_changed_tells_nothing() -> None:
    """Of drives without torque, as a recording that ended in a fault has them."""
    position = 1e-3 * np.sin(np.arange(500) / 50.0)
    with pytest.raises(Refused, match="the force never changed"):
        balance([Record(np.full(500, 0.2), position, PERIOD, 5e-9)])


def test_motion_at_one_place_leaves_open_what_lies_elsewhere() -> None:
    """A force that follows the place looks like mass in a sine: the interval of an ordinary recording allows for it."""

    def follow(t: float, x: float, v: float) -> float:
        w = 2.0 * math.pi * 2.0
        return 5000.0 * (2e-3 * math.sin(w * t) - x) + 100.0 * (2e-3 * w * math.cos(w * t) - v) + 20.0 * x

    force, position = record(Bristle(0.3, 5e-6, 20.0), follow, 2.0, mass=1.7, viscous=2.0)
    force = force - 20.0 * position  # the stage's own spring, which no fit knows
    one = [Record(force, position, PERIOD, 5e-9, skip=100)]
    planned, ordinary = balance(one).found, balance(one, ordinary=True).found
    assert not planned["mass"].holds(1.7)
    assert ordinary["mass"].value == planned["mass"].value
    for quantity in ("mass", "coulomb", "constant"):
        assert ordinary[quantity].half_width > planned[quantity].half_width
    assert ordinary["coulomb"].half_width > 0.03
