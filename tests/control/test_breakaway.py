"""From rest under friction that nobody knows: the force creeps up to it, and standstill teaches nothing."""

from typing import Any

import numpy as np
import pytest

from hil.control.laws.base import Array, LawInputs, Model, axis_inputs
from hil.control.laws.breakaway import Breakaway
from hil.control.laws.structured_filter import Covariance, diagonal, slide
from hil.control.laws.structured_kalman import StructuredKalman
from hil.control.trajectories.minimum_jerk import minimum_jerk

PERIOD = 1e-3
COUNT = 5e-9
MODEL = Model(mass=0.25, coulomb=0.20, viscous=0.0, quadratic=0.0, gravity=2.45)
GAINS = {
    "bandwidth": 0.172, "damping": 0.72, "acceleration_noise": 2.2e-4, "reversal_noise": 0.04, "bias_noise": 0.018,
    "coulomb_noise": 0.002, "viscous_noise": 0.0, "mass_noise": 0.07, "measurement_noise": 2.6e-9, "bias_prior": 0.084,
    "coulomb_prior": 0.02, "viscous_prior": 0.045, "mass_prior": 0.0075, "stribeck_velocity": 0.0025,
    "breakaway_rate": 5.0, "breakaway_lag": 1.25e-8,
}  # fmt: skip
REST, MOVE, WAY = 0.2, 0.6, 0.5e-3  # s, s, m


def plan(time: float) -> tuple[float, float]:
    """Down, a rest, and up again: position (m) and velocity (m/s)."""
    part, begun = divmod(max(time, 0.0), REST + MOVE)
    s, ds, _ = minimum_jerk(min(max((begun - REST) / MOVE, 0.0), 1.0))
    if part == 0:
        return -WAY * s, -WAY / MOVE * ds
    return (-WAY * (1.0 - s), WAY / MOVE * ds) if part == 1 else (0.0, 0.0)


class Axis:
    """A mass on set-valued friction that is not the model's, under a law on floats."""

    def __init__(self, *, mass: float = 0.26, dry: float = 0.24, weight: float = 2.55, **gains: Any) -> None:
        self.law = StructuredKalman(MODEL, PERIOD, 10.0, **{**GAINS, **gains})
        self.law.reset(0.0, MODEL.gravity)
        self._mass, self._dry, self._weight = mass, dry, weight
        self.position = self._velocity = 0.0
        self._last = self._before = self._acting = MODEL.gravity
        self._tick = 0

    def inputs(self) -> LawInputs:
        x = axis_inputs()
        x.position, x.fresh, x.sample_interval, x.ahead = round(self.position / COUNT) * COUNT, 1.0, PERIOD, PERIOD
        for reference, shift in ((x.sample, -1), (x.start, 0), (x.end, 1)):
            reference.position, reference.velocity = plan((self._tick + shift) * PERIOD)
        x.mean_velocity = (x.end.position - x.start.position) / PERIOD
        x.mean_acceleration = (x.end.velocity - x.start.velocity) / PERIOD
        x.force_last, x.force_before = self._last, self._before
        return x

    def tick(self) -> float:
        """One period; the error at its sample, m."""
        inputs = self.inputs()
        error: float = self.position - inputs.sample.position
        self._before, self._last = self._last, self.law.force(inputs)
        push = self._acting - self._weight
        self._velocity, way = slide(self._velocity, push, self._dry, PERIOD, 1.0 / self._mass)
        self.position += way
        self._acting = self._last
        self._tick += 1
        return error


def errors(ticks: int, **how: Any) -> Array:
    axis = Axis(**how)
    return np.array([axis.tick() for _ in range(ticks)])


def test_an_upward_move_after_downward_ones_alone_meets_unknown_gravity_and_friction_gently() -> None:
    """Moving down tells gravity's misfit less friction's, never the two: the first upward move lacks force."""
    crept, waited = errors(2000), errors(2000, breakaway_rate=0.0)
    up = slice(round(1e3 * (2 * REST + MOVE)), None)
    assert np.abs(crept[up]).max() < 0.6e-6
    assert np.abs(waited[up]).max() > 4 * np.abs(crept[up]).max()


@pytest.mark.parametrize("dry", [0.17, 0.30])
def test_too_little_and_too_much_friction_are_found_as_well(dry: float) -> None:
    found = np.abs(errors(2000, dry=dry))
    assert found.max() < 6e-6
    assert found[-300:].max() < 0.1e-6


def test_a_load_that_moves_the_axis_while_the_reference_rests_is_stopped() -> None:
    axis = Axis(dry=0.1)
    for _ in range(100):
        axis.tick()
    axis._weight += 0.6
    for _ in range(80):
        axis.tick()
    stands = axis.position
    for _ in range(15):
        axis.tick()
    assert -15e-6 < axis.position < 0.0
    assert abs(axis.position - stands) < 0.1e-6


def test_its_error_rate_is_the_axis_velocity_less_the_references() -> None:
    axis, off, rates = Axis(), [], []
    for _ in range(1600):
        rates.append(axis._velocity - axis.inputs().sample.velocity)
        axis.tick()
        off.append(axis.law.error_rate - rates[-1])
    assert np.abs(rates).max() > 3e-4  # where it breaks loose
    assert np.abs(off).max() < 3e-5
    assert np.abs(off)[-400:].max() < 6e-6


def matrix(p: Covariance) -> Array:
    full = np.zeros((6, 6))
    full[np.triu_indices(6)] = p
    return full + np.triu(full, 1).T


def test_the_covariance_stays_one_through_rest_creep_and_motion() -> None:
    """And the move in the unknown direction begins with what was unknown: rest and standstill have not used it up."""
    axis = Axis()
    unknown = []
    for _ in range(1100):
        axis.tick()
        p = matrix(axis.law._covariance)
        scale = np.sqrt(np.diag(p)) + 1e-30
        assert np.linalg.eigvalsh(p / np.outer(scale, scale)).min() > -1e-6
        up = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
        unknown.append(float(np.sqrt(up @ p @ up)))
    before, after = round(1e3 * (REST + MOVE)) + 5, round(1e3 * (2 * REST + MOVE)) - 5
    assert unknown[after] >= unknown[before] > 0.02


def test_an_axis_holds_until_it_has_gone_further_than_the_lag() -> None:
    start = Breakaway(5.0, 12e-9)
    start.reset(1e-3)
    assert start.watch(1e-3, 1.0, 0.0, 0.0) == (True, False, 1e-3)  # the reference rests: nothing to wait for
    assert start.watch(1e-3 + 10e-9, 1.0, 0.0, 1e-6) == (False, True, 1e-3 + 10e-9)
    assert start.watch(5e-3, 0.0, 1e-6, 2e-6) == (False, True, 1e-3)  # no sample: where it stood
    assert start.watch(1e-3 + 15e-9, 1.0, 2e-6, 3e-6)[:2] == (False, False)
    assert start.watch(1e-3, 1.0, 3e-6, 4e-6)[:2] == (False, False)  # it has slid, and holds no more before it rests
    assert start.watch(2e-3, 1.0, 0.0, 0.0)[:2] == (True, False)
    assert start.watch(2e-3, 1.0, 0.0, 1e-6)[:2] == (False, True)


def test_the_creep_leaves_what_is_known_of_the_other_direction() -> None:
    start = Breakaway(5.0, 12e-9)
    known_downwards = list(diagonal(0.0, 0.0, 1e-4, 1e-4, 0.0, 0.0))
    known_downwards[12] = 1e-4 - 1e-12  # d0 and theta1 correlated: d0 - theta1 is known
    p = tuple(known_downwards)
    bias, dry = start.creep(-20e-9, 1e-6, PERIOD, p)
    assert bias == pytest.approx(dry)
    assert bias + dry == pytest.approx(5e-3)
    assert start.creep(-10e-9, 1e-6, PERIOD, p) == (0.0, 0.0)  # the reference does not lead by enough
    assert start.creep(20e-9, 1e-6, PERIOD, p) == (0.0, 0.0)  # or the axis leads
    bias, dry = start.creep(20e-9, -1e-6, PERIOD, diagonal(0.0, 0.0, 1e-4, 3e-4, 0.0, 0.0))
    assert (bias, dry) == (pytest.approx(-1.25e-3), pytest.approx(3.75e-3))


def test_no_rate_means_no_say() -> None:
    assert not Breakaway(0.0, 1e-8).ever
    assert not Breakaway(np.zeros(2), np.zeros(2)).ever
    mixed = Breakaway(np.array([0.0, 5.0]), np.full(2, 1e-8))
    assert mixed.ever
    still, moving = np.zeros(2), np.full(2, 1e-6)
    assert mixed.watch(still, np.ones(2), still, still)[0].tolist() == [False, True]
    assert mixed.watch(still, np.ones(2), still, moving)[1].tolist() == [False, True]
