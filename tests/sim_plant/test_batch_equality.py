"""A batch of stages is bit for bit its members one by one, over every combination of what an axis can have."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_plant.config import PlantConfig
from sim_plant.physics.stage import Stage, Truth

MS = 1_000_000
EFFECTS: dict[str, Any] = {
    "presliding": [1e-6, 1e-5],
    "torque_lag": [3e-4, 1e-4],
    "torque_noise": [1e-3, 0.0],
    "modes": [{"axis": "x", "frequency_hz": 200.0, "load": 0.3}],
    "friction_variation": [0.1, 0.3],
    "cogging": [{"amplitude": 0.02, "period": 0.024}, {"axis": "y", "amplitude": 0.01, "period": 0.004, "phase": 1.0}],
    "cable_stiffness": [0.1, 5.0],
    "cable_hysteresis": [0.05, 0.0],
    "bias": [0.1, -0.2],
    "bias_walk": [0.05, 0.1],
    "vibration": [{"axis": "x", "acceleration": 0.05, "frequency_hz": 31.0}],
    "backlash": [1e-6, 0.0],
    "drift": [1e-7, 0.0],
    "encoder_noise": [5e-9, 1e-9],
    "encoder_periodic_error": [2e-8, 0.0],
    "encoder_latency": [2e-5, 7e-4],
    "stribeck_scale": [0.1, 0.2],
    "ripple_amplitude": [0.03, 0.0],
    "gravity": [0.0, -0.4],
    "cells": [{"axis": "x", "surface": 2e-6, "direction": 1, "stiffness": 1e14, "puncture_depth": 1e-5, "drag": 2.0}],
}

plants = st.builds(
    lambda chosen, mass, coulomb, seed: PlantConfig(
        mass=[mass, 0.3],
        coulomb=[coulomb, 0.4],
        viscous=[1.0, 2.0],
        quadratic=[0.1, 0.0],
        seed=seed,
        **{name: EFFECTS[name] for name in chosen},
    ),
    st.sets(st.sampled_from(sorted(EFFECTS))),
    st.floats(0.1, 1.5),
    st.floats(0.1, 1.0),
    st.integers(0, 2**32 - 1),
)
forces = st.lists(st.tuples(st.floats(-2.0, 2.0), st.floats(-1.5, 1.5)), min_size=1, max_size=6)


@settings(max_examples=60, deadline=None)
@given(st.lists(plants, min_size=1, max_size=4), st.sampled_from([1, 12]), forces, st.integers(1, 2 * MS))
def test_a_batch_is_bit_for_bit_its_members_one_by_one(
    members: list[PlantConfig], copies: int, pieces: list[tuple[float, float]], duration_ns: int
) -> None:
    truths = [Truth.from_config(plant, 2, ["x", "y"]) for plant in members]
    batch = Stage(Truth.stack(truths * copies))
    singles = [Stage(truth) for truth in truths]
    for piece in pieces:
        batch.advance(duration_ns, np.broadcast_to(piece, batch.truth.shape))
        shown = batch.read()
        for row, stage in enumerate(singles):
            stage.advance(duration_ns, list(piece))
            assert shown[row].tolist() == stage.readings()
            assert batch.position[row].tolist() == stage.positions
            assert batch.velocity[row].tolist() == stage.velocities
            assert batch.pierced[row].tolist() == stage.pierced.tolist()


def equal_step_by_step(members: list[PlantConfig], pieces: list[tuple[float, float]], copies: int) -> Stage:
    """The batch, once it has been held against its members over all pieces of a millisecond."""
    truths = [Truth.from_config(plant, 2, ["x", "y"]) for plant in members]
    batch, singles = Stage(Truth.stack(truths * copies)), [Stage(truth) for truth in truths]
    for piece in pieces:
        batch.advance(MS, np.broadcast_to(piece, batch.truth.shape))
        shown = batch.read()  # once: the encoders' noise goes on with every reading
        for row, stage in enumerate(singles):
            stage.advance(MS, list(piece))
            assert batch.position[row].tolist() == stage.positions
            assert batch.velocity[row].tolist() == stage.velocities
            assert batch.pierced[row].tolist() == stage.pierced.tolist()
            assert shown[row].tolist() == stage.readings()
    return batch


def plant_with(*effects: str) -> PlantConfig:
    base: dict[str, Any] = {"mass": [0.5, 0.3], "coulomb": [0.3, 0.4], "viscous": [1.0, 2.0], "quadratic": [0.1, 0.0]}
    base["initial_position"] = [9e-6, 0.0]  # at rest, 7 um into the membrane
    return PlantConfig(**base, **{name: EFFECTS[name] for name in effects})


# A push that friction and membrane together just hold; then through the membrane, to a stop, and back again.
THERE_AND_BACK = [(0.32, 0.0)] + [(2.0, -1.5)] * 4 + [(0.0, 0.0)] * 2 + [(-2.0, 1.5)] * 4


@pytest.mark.parametrize("effect", sorted(EFFECTS))
def test_with_any_two_effects_a_batch_is_its_members_and_each_effect_shows(effect: str) -> None:
    """Pairwise, by construction: a member for each pair this effect is in, and one without it for each, which differs:
    a batch that lost the effect where the other one is on would not.
    """
    others = [other for other in sorted(EFFECTS) if other > effect]
    pairs = [plant_with(effect, other) for other in others] + [plant_with(effect)]
    plain = [plant_with(other) for other in others] + [plant_with()]
    batch = equal_step_by_step(pairs + plain, THERE_AND_BACK, copies=1)
    shown = np.concatenate([batch.position, batch.velocity, batch.pierced, batch.read()], axis=1)
    same = [row for row in range(len(pairs)) if np.array_equal(shown[row], shown[row + len(pairs)])]
    assert not same, [others[row] for row in same]


@settings(max_examples=30, deadline=None)
@given(plants, forces)
def test_looking_ahead_changes_nothing(plant: PlantConfig, pieces: list[tuple[float, float]]) -> None:
    truth = Truth.from_config(plant, 2, ["x", "y"])
    watched, alone = Stage(truth), Stage(truth)
    for piece in pieces:
        peeked = watched.peek(MS, list(piece))[0]
        watched.advance(MS, list(piece))
        alone.advance(MS, list(piece))
        assert peeked.tolist() == watched.positions == alone.positions
    assert watched.readings() == alone.readings()
