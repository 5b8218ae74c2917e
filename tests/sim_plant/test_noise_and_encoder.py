"""What is random, and what the encoder shows: spectra, moments, and that the same seed gives the same."""

import math
from typing import Any

import numpy as np
import pytest

from sim_plant.config import PlantConfig
from sim_plant.physics.noise import ENCODER, TORQUE, WALK, Stream, uniform_of
from sim_plant.physics.single_axis import SingleAxis
from sim_plant.physics.stage import Stage, Truth
from sim_plant.stages import STAGES, staged

MS = 1_000_000
FREE: dict[str, Any] = {"mass": [0.5], "coulomb": [0.0], "viscous": [0.0], "quadratic": [0.0]}
PLANTS = 400


def batch_of(count: int = PLANTS, **keys: Any) -> Stage:
    """As many stages, each with a seed of its own."""
    return Stage(Truth.stack([Truth.from_config(PlantConfig(**keys, seed=seed), 1, ["x"]) for seed in range(count)]))


def split_mix(z: int) -> int:
    """The finalizer of SplitMix64 in whole numbers."""
    z = ((z ^ z >> 30) * 0xBF58476D1CE4E5B9) % 2**64
    z = ((z ^ z >> 27) * 0x94D049BB133111EB) % 2**64
    return z ^ z >> 31


def number_of(seed: int, axis: int, effect: int, count: int) -> float:
    """The count-th number of a stream, in whole numbers."""
    key = split_mix((seed * 0x9E3779B97F4A7C15 + 0x632BE59BD9B4E019) % 2**64)
    key = split_mix((key + axis * 0xD1342543DE82EF95 + effect * 0x2545F4914F6CDD1D) % 2**64)
    place = key + count * 0x9E3779B97F4A7C15
    ones, more = split_mix(place % 2**64), split_mix(place % 2**64 ^ 2**64 - 1)
    return float((ones.bit_count() - 32 + ((more >> 11) * 2.0**-53 - 0.5)) * 0.24935149047701485)


def test_one_axis_and_many_draw_what_whole_numbers_give() -> None:
    seeds, axes = np.array([7, 2**32 - 1, 7], dtype=np.uint64), np.array([0, 3, 2], dtype=np.uint64)
    for effect in (TORQUE, WALK, ENCODER):
        many = Stream(seeds, axes, effect)
        alone = [Stream(seed, axis, effect) for seed, axis in zip(seeds.tolist(), axes.tolist(), strict=True)]
        for count in (0, 1, 2, 63, 64, 65, 64, 63, 200, 0, 10**12):  # forward, and back over the edge of a block
            expected = [number_of(int(seed), int(axis), effect, count) for seed, axis in zip(seeds, axes, strict=True)]
            assert many.at(count).tolist() == expected
            assert [stream.at(count) for stream in alone] == expected


def test_the_numbers_have_the_moments_of_a_normal_distribution_and_are_white() -> None:
    stream, another = Stream(7, 0, 1), Stream(7, 1, 1)
    numbers = np.array([stream.at(count) for count in range(20_000)])
    assert numbers.mean() == pytest.approx(0.0, abs=0.03)
    assert numbers.std() == pytest.approx(1.0, abs=0.02)
    assert (numbers**4).mean() / numbers.var() ** 2 == pytest.approx(2.97, abs=0.12)
    for lag in (1, 2, 17):
        assert abs(np.mean(numbers[lag:] * numbers[:-lag])) < 0.03
    other = np.array([another.at(count) for count in range(5_000)])
    assert abs(np.mean(numbers[:5_000] * other)) < 0.05


def test_torque_noise_has_the_density_it_says() -> None:
    """A free mass integrates white force of one-sided density S into a velocity of variance S^2 t / (2 m^2)."""
    stage = batch_of(**FREE, torque_noise=1e-3)
    stage.advance(200 * MS, np.zeros((PLANTS, 1)))
    assert stage.velocity.std() == pytest.approx(1e-3 / 0.5 * math.sqrt(0.2 / 2), rel=0.12)
    assert abs(stage.velocity.mean()) < 4 * stage.velocity.std() / math.sqrt(PLANTS)


def test_the_spectrum_of_the_torque_noise_is_flat() -> None:
    stage = Stage(Truth.from_config(PlantConfig(**FREE, torque_noise=1e-3), 1, ["x"]))
    force, before = [], 0.0
    for _ in range(4096):
        stage.advance(MS // 2, [0.0])
        force.append(0.5 * (stage.velocities[0] - before) / 0.5e-3)
        before = stage.velocities[0]
    spectrum = np.abs(np.fft.rfft(force)) ** 2 * 2 / (4096 * 2000)  # one-sided, N^2/Hz
    for part in np.array_split(spectrum[1:], 4):
        assert part.mean() == pytest.approx(1e-6, rel=0.15)


def test_a_walking_bias_spreads_with_the_root_of_time() -> None:
    stage = batch_of(**{**FREE, "viscous": [50.0]}, bias_walk=0.1)
    spreads = []
    for _ in range(2):
        stage.advance(500 * MS, np.zeros((PLANTS, 1)))
        spreads.append(float(stage.velocity.std()) * 50.0)
    assert spreads[0] == pytest.approx(0.1 * math.sqrt(0.5), rel=0.12)
    assert spreads[1] == pytest.approx(0.1, rel=0.12)


def test_an_encoder_is_noisy_periodic_and_late_as_it_says() -> None:
    noisy = batch_of(**FREE, encoder_noise=2e-9)
    samples = np.array([noisy.read()[:, 0] for _ in range(50)])
    assert samples.std() == pytest.approx(2e-9, rel=0.03)
    assert abs(np.mean(samples[1:] * samples[:-1])) < 0.02 * samples.var()

    plant = PlantConfig(**FREE, encoder_periodic_error=4e-8, encoder_period=2e-5)
    for position in (0.0, 5e-6, 1.5e-5, 7.1e-3):
        stage = Stage(Truth.from_config(plant, 1), position)
        shown = position + 4e-8 * math.sin(2 * math.pi * position / 2e-5)
        assert stage.readings()[0] == pytest.approx(shown, abs=1e-13)


@pytest.mark.parametrize("latency", [2e-5, 3e-4, 9e-4])
def test_a_late_encoder_shows_where_the_motor_was(latency: float) -> None:
    keys: dict[str, Any] = {"mass": [0.93], "coulomb": [0.66], "viscous": [3.2], "quadratic": [0.0], "presliding": 1e-6}
    late = Stage(Truth.from_config(PlantConfig(**keys, encoder_latency=latency), 1))
    now = Stage(Truth.from_config(PlantConfig(**keys), 1))
    early_ns = round(latency * 1e9)
    for i in range(60):
        force = [1.2 * math.sin(2 * math.pi * i / 40)]
        late.advance(MS, force)
        now.advance(MS - early_ns, force)
        assert late.readings()[0] == pytest.approx(now.positions[0], abs=1e-9)
        now.advance(early_ns, force)


def test_one_seed_is_one_run_and_axes_and_seeds_differ() -> None:
    keys: dict[str, Any] = {
        "mass": [0.5, 0.5],
        "coulomb": [0, 0],
        "viscous": [0, 0],
        "quadratic": [0, 0],
        "torque_noise": 1e-3,
    }

    def run(seed: int) -> list[float]:
        stage = Stage(Truth.from_config(PlantConfig(**keys, seed=seed), 2))
        stage.advance(10 * MS, [0.0, 0.0])
        return stage.positions

    assert run(1) == run(1)
    assert run(1) != run(2)
    assert run(1)[0] != run(1)[1]


@pytest.mark.parametrize("name", [name for name in STAGES if name != "ideal"])
def test_a_kind_of_stage_sets_values_that_single_keys_override(name: str) -> None:
    keys: dict[str, Any] = {"mass": [0.9, 0.5], "coulomb": [0.6, 0.4], "viscous": [3.0, 2.0], "quadratic": [0.0, 0.0]}
    whole = staged(PlantConfig(**keys, stage=name))
    assert staged(PlantConfig.model_validate(whole.model_dump())) == PlantConfig.model_validate(whole.model_dump())
    assert whole.torque_lag > 0.0  # type: ignore[operator]
    mine = staged(PlantConfig(**keys, stage=name, torque_lag=0.0, modes=[]))
    assert (mine.torque_lag, mine.modes, mine.encoder_noise) == (0.0, [], whole.encoder_noise)
    stage = Stage(Truth.from_config(whole, 2, ["x", "y"]))
    for _ in range(20):
        stage.advance(MS, [1.0, 0.5])
    assert all(map(math.isfinite, stage.positions))


def test_an_ideal_stage_costs_nothing_and_keeps_its_solver() -> None:
    stage = Stage(Truth.from_config(PlantConfig(**FREE), 1))
    assert not stage._deviates
    assert all(type(axis) is SingleAxis for axis in stage._alone.axes)
    assert all(encoder.is_ideal for encoder in stage._alone.encoders)


@pytest.mark.parametrize("key", [0, 1, 0x9E3779B97F4A7C15, 2**64 - 1])
def test_uniform_numbers_are_those_of_split_mix(key: int) -> None:
    found = [uniform_of(key, count) for count in range(300)]
    assert found == [(split_mix((key + count * 0x9E3779B97F4A7C15) % 2**64) >> 11) * 2.0**-53 for count in range(300)]
    assert all(0.0 <= number < 1.0 for number in found)
    assert np.mean(found) == pytest.approx(0.5, abs=0.06)
