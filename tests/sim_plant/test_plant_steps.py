"""Steps of the plant's effects: a kind of scenario for each of them, the same on one stage and on a batch."""

from dataclasses import fields
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from sim_plant.config import PlantConfig
from sim_plant.physics.stage import Stage, Truth
from sim_plant.physics.truth import FIRST_LINE
from sim_plant.scenario.language import KINDS, PLANT_PREFIX
from tests.golden.plants.tell import EFFECTS, MS, shown_by

IDEAL = {"mass", "coulomb", "viscous", "quadratic", "gravity", "modelling_error", "puncture_depth", "seed"}
FIXED = {"other_modes", "slip"}  # what no step changes
IDEAL_BEGIN = ("stribeck", "ripple", "cell")
STEPS = {
    "presliding": 3e-6, "presliding_damping": 0.6, "torque_lag": 8e-4, "torque_noise": 0.02, "mode_frequency": 90.0,
    "mode_damping": 0.3, "mode_load": 0.5, "friction_variation": 0.4, "friction_period": 3e-4, "friction_phase": 2.0,
    "cogging": 0.2, "cogging_period": 3e-4, "cogging_phase": 2.0, "cable_stiffness": 80.0, "cable_hysteresis": 0.1,
    "cable_reach": 2e-5, "bias": 0.3, "bias_walk": 0.5, "vibration": 0.5, "vibration_frequency": 80.0,
    "backlash": 4e-6, "drift": 1e-4, "encoder_noise": 5e-8, "encoder_periodic_error": 2e-7, "encoder_period": 7e-6,
    "encoder_latency": 3e-4,
}  # fmt: skip
BEFORE = 4
PUSHES = [(2.0, -1.5)] * 6 + [(-2.0, 1.5)] * 3  # N, a millisecond each


def truth_of(seed: int) -> Truth:
    """Two axes with every effect there is, but for the membrane."""
    known = {effect: value for effect, value in EFFECTS.items() if effect != "cells"}
    plant = PlantConfig(
        mass=[0.5, 0.3], coulomb=[0.3, 0.4], viscous=[1.0, 2.0], quadratic=[0.1, 0.0], seed=seed, **known
    )
    return Truth.from_config(plant, 2, ["x", "y"])


def played(stage: Stage, key: str | None) -> NDArray[np.float64]:
    """All that is to be seen, millisecond by millisecond; x takes the step after BEFORE of them."""
    seen = []
    for k, push in enumerate(PUSHES):
        if k == BEFORE and key is not None:
            stage.change(stage.truth.changed(0, key, STEPS[key])[0])
        stage.advance(MS, np.broadcast_to(push, stage.truth.shape))
        seen.append(shown_by(stage) if len(stage.truth.shape) > 1 else shown_by_one(stage))
    return np.array(seen)


def shown_by_one(stage: Stage) -> NDArray[np.float64]:
    """As `shown_by`, of one stage."""
    return np.array([*stage.positions, *stage.velocities, *stage.pierced.tolist(), *stage.readings()])


@cache
def without() -> NDArray[np.float64]:
    """What is seen of a stage without a step."""
    return played(Stage(truth_of(1)), None)


def test_every_effect_of_the_plant_has_a_kind() -> None:
    effects = (
        {name for name in (field.name for field in fields(Truth)) if not name.startswith(IDEAL_BEGIN)} - IDEAL - FIXED
    )
    kinds = {kind.removeprefix(PLANT_PREFIX) for kind in KINDS if kind.startswith(PLANT_PREFIX)}
    assert kinds == effects | set(FIRST_LINE) == set(STEPS)
    assert [key for key, value in STEPS.items() if not KINDS[PLANT_PREFIX + key].low <= value] == []


@pytest.mark.long
@pytest.mark.parametrize("key", STEPS)
def test_a_step_shows_on_its_axis_alone_and_is_to_the_bit_the_same_in_a_batch(key: str) -> None:
    stepped, steady = played(Stage(truth_of(1)), key), without()
    assert np.array_equal(stepped[:BEFORE], steady[:BEFORE])
    assert not np.array_equal(stepped[BEFORE:, 0::2], steady[BEFORE:, 0::2]), "x"
    assert np.array_equal(stepped[:, 1::2], steady[:, 1::2]), "y"
    batch = played(Stage(Truth.stack([truth_of(1), truth_of(2)])), key)
    assert np.array_equal(batch[:, 0], stepped)
    assert np.array_equal(batch[:, 1], played(Stage(truth_of(2)), key))


@pytest.mark.parametrize("key", STEPS)
def test_a_step_back_leaves_the_truth_as_it_was(key: str) -> None:
    truth = truth_of(1)
    stepped, before = truth.changed(0, key, STEPS[key])
    back, value = stepped.changed(0, key, float(before))
    assert float(value) == pytest.approx(STEPS[key], rel=1e-15)
    for field in fields(Truth):
        for one, other in zip(getattr(truth, field.name), getattr(back, field.name), strict=True):
            assert np.array_equal(one, other), field.name


def test_what_an_axis_has_none_of_yet_begins_with_what_plant_has_by_default() -> None:
    bare = Truth.from_config(
        PlantConfig(mass=[0.5, 0.3], coulomb=[0.3, 0.4], viscous=[1.0, 2.0], quadratic=[0.1, 0.0], ripple_period=0.03),
        2,
        ["x", "y"],
    )
    assert bare.changed(1, "mode_frequency", 200.0)[0].mode_load.tolist() == [0.0, 0.3]
    assert bare.changed(1, "cogging", 0.1)[0].cogging["wavenumber"][:, 0].tolist() == [0.0, 1.0 / 0.03]
    assert bare.changed(1, "vibration", 0.1)[0].vibration["wavenumber"][:, 0].tolist() == [0.0, 25.0]
    both = Truth.stack([bare, bare.changed(1, "mode_frequency", 90.0)[0]])
    again, before = both.changed(1, "mode_frequency", 200.0)
    assert before.tolist() == [0.0, 90.0]
    assert again.mode_load[:, 1].tolist() == [0.3, 0.3]
