"""A batch of stages is bit for bit its members one by one, over every combination of what an axis can have."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_plant.config import PlantConfig
from sim_plant.physics.stage import Stage, Truth
from tests.golden.golden import hold
from tests.golden.plants.tell import EFFECTS, MS, THERE_AND_BACK, lines, plant_with, shown_by, with_and_without

OTHERS = [{"axis": "x", "frequency_hz": 330.0, "load": 0.05}, {"axis": "x", "frequency_hz": 900.0, "load": 0.02}]
ELEMENTS = [
    {"axis": "x", "stiffness": 4.0, "limit": 1.0},
    *[{"axis": "x", "limit": limit} for limit in (1.0, 2.0, 7.0)],
]
plants = st.builds(
    lambda chosen, others, elements, mass, coulomb, seed: PlantConfig(
        mass=[mass, 0.3],
        coulomb=[coulomb, 0.4],
        viscous=[1.0, 2.0],
        quadratic=[0.1, 0.0],
        seed=seed,
        **{name: EFFECTS[name] + OTHERS[:others] * (name == "modes") for name in chosen},
        slip=ELEMENTS[: elements * ("presliding" in chosen)],
    ),
    st.sets(st.sampled_from(sorted(EFFECTS))),
    st.integers(0, 2),
    st.integers(0, 4),
    st.floats(0.1, 1.5),
    st.floats(0.1, 1.0),
    st.integers(0, 2**32 - 1),
)
forces = st.lists(st.tuples(st.floats(-2.0, 2.0), st.floats(-1.5, 1.5)), min_size=1, max_size=6)


@pytest.mark.long
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


@pytest.mark.long
@pytest.mark.parametrize("effect", sorted(EFFECTS))
def test_with_any_two_effects_a_batch_is_its_members_and_each_effect_shows(effect: str) -> None:
    """A batch that lost the effect where another one is on would show what the plant without it does; and what it shows
    has not changed, to the bit (tests/golden/plants).
    """
    pairs, plain = with_and_without(effect)
    shown = shown_by(equal_step_by_step([*pairs, *plain], THERE_AND_BACK, copies=1))
    same = [row for row in range(len(pairs)) if np.array_equal(shown[row], shown[row + len(pairs)])]
    assert not same, same
    hold("plants", effect, lines(effect, shown))


def with_numbers_of_its_own(number: int) -> PlantConfig:
    """A plant none of whose numbers is another's, in need of more steps than those before it."""
    grown, axis = 1.0 + 0.07 * number, {"axis": "x"}
    cell = {"surface": 2e-6 * grown, "stiffness": 1e14 / grown, "puncture_depth": 1e-5 * grown, "drag": grown}
    return PlantConfig(
        mass=[0.5 * grown, 0.3 / grown],
        coulomb=[0.3 * grown, 0.4],
        viscous=[1.0, 2.0 * grown],
        quadratic=[0.1, 0.0],
        initial_position=[9e-6, 0.0],
        presliding=[1e-5 / 2**number, 1e-5 / grown],
        torque_lag=[1e-3 / grown, 2e-4],
        stribeck_scale=[0.1 * grown, 0.2],
        cable_stiffness=[0.1, 5.0 * grown],
        cells=[axis | cell],
        cogging=[axis | {"amplitude": 0.02 * grown, "period": 0.024 * grown}],
        friction_variation=[0.1 * grown, 0.3],
        vibration=[axis | {"acceleration": 0.05 * grown, "frequency_hz": 31.0 * grown}],
    )


def test_members_that_need_different_steps_keep_their_own_numbers() -> None:
    """They are sorted by how many steps they need, and taken out of the batch when they are through."""
    equal_step_by_step([with_numbers_of_its_own(number) for number in range(10)], THERE_AND_BACK[:6], copies=1)


def test_a_member_that_would_need_more_steps_than_there_are_gets_the_most() -> None:
    base = {"mass": [0.5, 0.3], "coulomb": [0.3, 0.4], "viscous": [1.0, 2.0], "quadratic": [0.1, 0.0]}
    members = [
        PlantConfig(**base, torque_lag=1e-3, cogging=[{"axis": "x", "amplitude": 0.1, "period": period}])
        for period in (1e-9, 1e-2)
    ]
    equal_step_by_step(members, [(1.0, 0.1)], copies=1)


def test_noise_goes_on_where_it_was_when_brakes_grip_and_let_go() -> None:
    truths = [Truth.from_config(plant_with("encoder_noise", name), 2, ["x", "y"]) for name in ("drift", "gravity")]
    batch, singles = Stage(Truth.stack(truths)), [Stage(truth) for truth in truths]
    seen = []
    for force in (0.0, 50.0, 50.0, 0.0):
        batch.clamp(np.full(batch.truth.shape, force))
        batch.advance(MS, np.zeros(batch.truth.shape))
        seen.append(batch.read().tolist())
        for row, stage in enumerate(singles):
            stage.clamp([force] * 2)
            stage.advance(MS, [0.0] * 2)
            assert seen[-1][row] == stage.readings()
    assert len({tuple(shown[0]) for shown in seen}) == 4, "no draw of noise comes twice"


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
