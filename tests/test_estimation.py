"""The hot path applies gains that filterpy designed; here the two filters are held equal."""

import numpy as np
import pytest

from hil.config import RigConfig
from hil.estimation import MotionFilter, design_gains, filter_parameters
from hil.estimation_design import make_filter, steady_gains


def settled_filterpy(parameters: dict[str, float]):  # type: ignore[no-untyped-def]
    kf = make_filter(**parameters)
    steady_gains(kf)
    kf.x = np.zeros((3, 1))
    return kf


@pytest.mark.parametrize("axis", [0, 1])
def test_the_hot_path_equals_filterpy_once_the_covariance_has_settled(paper: RigConfig, axis: int) -> None:
    parameters = filter_parameters(paper)[axis]
    reference = settled_filterpy(parameters)
    gains, variance = design_gains(paper)
    mass = np.array([a.model.mass for a in paper.axes.values()])
    ours = MotionFilter(gains, variance, mass, (2,))
    interval = np.full(2, parameters["period"])
    rng = np.random.Generator(np.random.PCG64(4))
    for _ in range(500):
        force, measured = rng.normal(0, 1), rng.normal(0, 1e-4)
        reference.predict(u=np.array([[force]]))
        reference.update(np.array([[measured]]))
        ours.predict(np.full(2, force), interval)
        ours.innovate(np.full(2, measured))
        ours.update(None)
        state = [ours.position[axis], ours.velocity[axis], ours.disturbance[axis]]
        scale = np.abs(reference.x[:, 0]) + np.array([1e-4, 1e-1, 1.0])
        assert np.all(np.abs(state - reference.x[:, 0]) <= 1e-6 * scale)


def test_the_one_period_delay_is_compensated_exactly_for_a_known_force(paper: RigConfig) -> None:
    gains, variance = design_gains(paper)
    mass = np.array([0.02, 0.01])
    ours = MotionFilter(gains, variance, mass, (2,))
    ours.reseed(np.array([0.5, -0.5]))
    force, ahead = np.array([1.0, -2.0]), np.array([1e-3, 2e-3])
    ours.look_ahead(force, ahead)
    assert np.allclose(ours.ahead_position, [0.5 + 0.5 * 50 * 1e-6, -0.5 - 0.5 * 200 * 4e-6], rtol=1e-15)
    assert np.allclose(ours.ahead_velocity, [50 * 1e-3, -200 * 2e-3], rtol=1e-15)
    assert ours.position.tolist() == [0.5, -0.5]


def test_an_axis_without_a_sample_is_predicted_and_not_corrected(paper: RigConfig) -> None:
    gains, variance = design_gains(paper)
    ours = MotionFilter(gains, variance, np.array([0.02, 0.01]), (2,))
    ours.innovate(np.array([1e-3, 1e-3]))
    ours.update(np.array([1.0, 0.0]))
    assert ours.position[0] > 0.0
    assert ours.position[1] == 0.0
    assert ours.disturbance[1] == 0.0


def test_a_batch_gives_the_same_bits_as_its_members(paper: RigConfig) -> None:
    gains, variance = design_gains(paper)
    mass = np.array([0.02, 0.01])
    rng = np.random.Generator(np.random.PCG64(5))
    batch = MotionFilter(gains, variance, mass, (3, 2))
    singles = [MotionFilter(gains, variance, mass, (2,)) for _ in range(3)]
    for _ in range(50):
        force, measured = rng.normal(size=(3, 2)), rng.normal(scale=1e-5, size=(3, 2))
        interval = np.full((3, 2), 1e-3)
        for filt, f, m, i in [(batch, force, measured, interval)] + [
            (s, force[k], measured[k], interval[k]) for k, s in enumerate(singles)
        ]:
            filt.predict(f, i)
            filt.innovate(m)
            filt.update(None)
            filt.look_ahead(f, i)
    for k, single in enumerate(singles):
        assert batch.ahead_position[k].tobytes() == single.ahead_position.tobytes()
        assert batch.disturbance[k].tobytes() == single.disturbance.tobytes()
