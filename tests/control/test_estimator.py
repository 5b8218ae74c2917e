"""The hot path applies gains that filterpy designed; here the two filters are held equal."""

import numpy as np
import pytest

from hil.control.estimator.filterpy_design import make_filter, steady_gains
from hil.control.estimator.gains import design_gains, filter_parameters
from hil.control.estimator.motion_filter import MotionFilter
from hil.rig.schema import RigConfig


def settled_filterpy(parameters: dict[str, float]):  # type: ignore[no-untyped-def]
    kf = make_filter(**parameters)
    steady_gains(kf)
    kf.x = np.zeros((3, 1))
    return kf


@pytest.mark.parametrize("axis", [0, 1])
def test_the_hot_path_equals_filterpy_once_the_covariance_has_settled(paper: RigConfig, axis: int) -> None:
    parameters = filter_parameters(paper)[axis]
    reference = settled_filterpy(parameters)
    gains, _ = design_gains(paper)
    mass = np.array([a.model.mass for a in paper.axes.values()])
    ours = MotionFilter(gains[:, axis].tolist(), float(mass[axis]))
    rng = np.random.Generator(np.random.PCG64(4))
    for _ in range(500):
        force, measured = rng.normal(0, 1), rng.normal(0, 1e-4)
        reference.predict(u=np.array([[force]]))
        reference.update(np.array([[measured]]))
        ours.correct(force, parameters["period"], measured)
        state = [ours.position, ours.velocity, ours.disturbance]
        scale = np.abs(reference.x[:, 0]) + np.array([1e-4, 1e-1, 1.0])
        assert np.all(np.abs(state - reference.x[:, 0]) <= 1e-6 * scale)


def test_the_one_period_delay_is_compensated_exactly_for_a_known_force(paper: RigConfig) -> None:
    gains, _ = design_gains(paper)
    ours = MotionFilter(gains[:, 0].tolist(), 0.02)
    ours.reseed(0.5)
    ours.look_ahead(1.0, 2e-3)
    assert ours.ahead_position == pytest.approx(0.5 + 0.5 * 50 * 4e-6, rel=1e-15)
    assert ours.ahead_velocity == pytest.approx(50 * 2e-3, rel=1e-15)
    assert ours.position == 0.5


def test_an_axis_without_a_sample_is_predicted_and_not_corrected(paper: RigConfig) -> None:
    gains, _ = design_gains(paper)
    heard, silent = (MotionFilter(gains[:, 0].tolist(), 0.02) for _ in range(2))
    heard.correct(1.0, 1e-3, 1e-3, fresh=1.0)
    silent.correct(1.0, 1e-3, 1e-3, fresh=0.0)
    assert heard.position > silent.position == pytest.approx(0.5 * 50 * 1e-6)
    assert silent.disturbance == silent.innovation == 0.0


def test_after_a_long_interval_the_filter_does_not_run_away(paper: RigConfig) -> None:
    """Eight periods without a tick: the gains' shares of the innovation per second stay what they were."""
    gains, _ = design_gains(paper)
    short, long = (MotionFilter(gains[:, 0].tolist(), 0.02) for _ in range(2))
    short.correct(0.0, 1e-3, 1e-6)
    long.correct(0.0, 8e-3, 1e-6, stretch=8.0)
    assert long.position == short.position
    assert long.velocity == short.velocity / 8.0
    assert long.disturbance == short.disturbance / 64.0


def test_a_batch_of_arrays_gives_the_same_bits_as_its_members_on_floats(paper: RigConfig) -> None:
    gains, _ = design_gains(paper)
    mass = np.array([0.02, 0.01])
    rng = np.random.Generator(np.random.PCG64(5))
    batch = MotionFilter(list(gains), mass)
    batch.reseed(np.zeros((3, 2)))
    singles = {
        (k, axis): MotionFilter(gains[:, axis].tolist(), float(mass[axis])) for k in range(3) for axis in range(2)
    }
    for _ in range(50):
        force, measured = rng.normal(size=(3, 2)), rng.normal(scale=1e-5, size=(3, 2))
        batch.correct(force, 1e-3, measured)
        batch.look_ahead(force, 1e-3)
        for place, single in singles.items():
            single.correct(float(force[place]), 1e-3, float(measured[place]))
            single.look_ahead(float(force[place]), 1e-3)
    for place, single in singles.items():
        assert batch.ahead_position[place] == single.ahead_position
        assert batch.disturbance[place] == single.disturbance
