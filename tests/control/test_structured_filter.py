"""The structured filter's axis: reversals between ticks, sticking, sliding, breaking away."""

from typing import Any

import numpy as np
import pytest

from hil.control.laws.base import Model, axis_inputs
from hil.control.laws.structured_filter import keep_disturbance, sign_array, sign_float, slide, standing
from hil.control.laws.structured_kalman import StructuredKalman
from hil.rig.file import load_rig
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import RIGS

PERIOD = 1e-3


@pytest.mark.parametrize(
    ("v0", "v1", "coulomb", "sign"),
    [
        (1.0, 0.5, 1.0, 1.0),
        (-1.0, -0.5, 1.0, -1.0),
        (0.0, 0.0, 1.0, 0.0),
        (0.01, -0.03, 0.0, -0.5),
        (0.0, 0.02, 1.0, 1.0),
    ],
)
def test_mean_sign_is_that_of_the_reference_away_from_reversals(
    v0: float, v1: float, coulomb: float, sign: float
) -> None:
    assert sign_float(v0, v1, PERIOD, 0.02, coulomb)[0] == pytest.approx(sign)


def test_a_reversal_between_ticks_is_solved_as_stiction_plays_it() -> None:
    """The force that the law derives takes a Coulomb-braked mass from v0 to v1 in one period, by fine integration."""
    mass, coulomb, v0, v1 = 0.022, 1.4, 0.002, -0.008
    mean, stuck, shift = sign_float(v0, v1, PERIOD, mass, coulomb)
    force = mass * (v1 - v0) / PERIOD + coulomb * mean
    assert stuck == 0.0
    steps = 200_000
    h, velocity, position = PERIOD / steps, v0, 0.0
    for _ in range(steps):
        friction = coulomb if velocity > 0 else -coulomb
        velocity += h * (force - friction) / mass
        position += h * velocity
    assert velocity == pytest.approx(v1, abs=1e-5)
    assert position == pytest.approx(0.5 * (v0 + v1) * PERIOD + shift, abs=1e-8)


def test_what_a_reversal_takes_of_the_way_is_that_of_its_pieces() -> None:
    """From v0 to rest at a constant rate, then on to v1, or, where friction holds it, nowhere."""
    random = np.random.default_rng(8)
    early = late = 0
    for v0, v1, coulomb in 0.01 * random.uniform((-1.0, -1.0, 0.0), (1.0, 1.0, 200.0), (200, 3)):
        if v0 * v1 >= 0.0:
            continue
        sign, stuck, shift = sign_float(v0, v1, PERIOD, 0.02, coulomb)
        if stuck:
            late += 1
            to_rest = abs(v0) / (abs(v0) + abs(v1))  # of the interval: where the reference turns
            assert 0.5 * PERIOD * v0 + shift == pytest.approx(0.5 * PERIOD * v0 * to_rest, abs=1e-12)
            assert (stuck, sign) == (pytest.approx(0.02 * v1 / PERIOD), np.sign(v0))
        else:
            early += 1
            to_rest = 0.5 * (1.0 - sign * np.sign(v1))
            way = 0.5 * PERIOD * (v0 * to_rest + v1 * (1.0 - to_rest))
            assert 0.5 * PERIOD * (v0 + v1) + shift == pytest.approx(way, abs=1e-12)
    assert min(early, late) > 10


def test_reversals_are_the_same_for_floats_and_arrays() -> None:
    random = np.random.default_rng(5)
    v0, v1 = 0.01 * random.standard_normal((2, 500))
    mass, coulomb = np.full(500, 0.02), random.uniform(-0.1, 1.0, 500)
    many = sign_array(v0, v1, np.full(500, PERIOD), mass, coulomb)
    for k in range(500):
        one = sign_float(float(v0[k]), float(v1[k]), PERIOD, 0.02, float(coulomb[k]))
        assert one == tuple(float(values[k]) for values in many)


def test_the_covariance_of_the_disturbance_is_kept_entry_by_entry() -> None:
    before, after = tuple(float(number) for number in range(21)), tuple(100.0 + number for number in range(21))
    assert standing(before, 7.0) == (7.0, *[0.0] * 10, *before[11:])  # type: ignore[arg-type]
    assert keep_disturbance(after, before, True) == (*after[:11], *before[11:])  # type: ignore[arg-type]
    assert keep_disturbance(after, before, False) == after  # type: ignore[arg-type]
    arrays = [tuple(np.array([value, value]) for value in p) for p in (after, before)]
    both = keep_disturbance(*arrays, np.array([True, False]))  # type: ignore[arg-type]
    assert [tuple(float(value[k]) for value in both) for k in (0, 1)] == [(*after[:11], *before[11:]), after]


def slid(velocity: float, push: float, dry: float, time: float, mass: float) -> tuple[float, float]:
    """By fine implicit steps (Moreau): friction takes what it can, up to `dry`."""
    steps, way = 20_000, 0.0
    h = time / steps
    for _ in range(steps):
        free = velocity + h * push / mass
        friction = min(max(free * mass / h, -dry), dry)
        velocity = free - h * friction / mass
        way += h * velocity
    return velocity, way


def test_the_filters_axis_slides_sticks_and_turns_as_set_valued_friction_has_it() -> None:
    mass, dry = 0.02, 1.0
    cases = [(0.01, 0.5), (0.01, -0.5), (0.01, -1.3), (-0.01, 1.3), (0.0, 0.9), (0.0, 1.1), (0.0, -1.1), (-0.1, 0.2)]
    for velocity, push in cases:
        end, way = slide(velocity, push, dry, PERIOD, 1.0 / mass)
        assert (end, way) == pytest.approx(slid(velocity, push, dry, PERIOD, mass), abs=5e-8 + 2e-4 * abs(end))
        assert slide(-velocity, -push, dry, PERIOD, 1.0 / mass) == (-end, -way)
    assert slide(0.0, 0.9, dry, PERIOD, 1.0 / mass) == (0.0, 0.0)
    velocities, pushes = np.array(cases).T
    many = slide(
        velocities, pushes, np.full(len(cases), dry), np.full(len(cases), PERIOD), np.full(len(cases), 1.0 / mass)
    )
    for index, (velocity, push) in enumerate(cases):
        assert tuple(float(v[index]) for v in many) == slide(velocity, push, dry, PERIOD, 1.0 / mass)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_an_axis_that_waits_for_its_reversal_is_expected_to_be_where_friction_holds_it(way: float) -> None:
    """The force of the interval stops the axis late in it, and friction holds it while the reference moves on."""
    mass, dry, v0, v1, v2 = 0.02, 1.0, way * 7e-3, way * -3e-3, way * -13e-3
    law = StructuredKalman(Model(mass, dry, 0.0, 0.0, 0.0), PERIOD, 5.0)
    x = axis_inputs()
    x.answered = x.fresh = 1.0
    x.ahead, x.sample.velocity = PERIOD, v0
    x.start.velocity, x.start.position, x.end.velocity = v1, 0.5 * (v0 + v1) * PERIOD, v2
    x.mean_velocity, x.mean_acceleration = 0.5 * (v1 + v2), (v2 - v1) / PERIOD
    law.force(x)  # the first sample
    x.force_last = mass * (v1 - v0) / PERIOD + way * dry
    end, moved = slid(v0, x.force_last, dry, PERIOD, mass)
    assert abs(end) < 1e-9
    known = mass * (v2 - v1) / PERIOD - way * dry + mass * v1 / PERIOD  # and the speed that the reference has already
    error, rate = moved - x.start.position, end - v1
    assert law.force(x) == pytest.approx(known - law.stiffness * error - law.damping * rate, rel=1e-4)


def test_an_axis_that_has_not_broken_away_teaches_no_bias() -> None:
    """Friction is three times the model's: the reference moves there and back while the axis sticks."""
    rig = load_rig(RIGS / "paper.toml", ["law.name=structured-kalman", "plant.coulomb=[3.4, 0.9]", "task.radius=5e-6"])
    run = LockstepRun(rig, RIGS)
    for _ in range(3000):
        run.tick()
    assert np.abs(run.true_position).max() < 1e-6
    laws: Any = run.cycle.law
    for learnt, limit in zip(laws.laws, (3.4, 0.9), strict=True):
        bias, coulomb, _, _ = learnt._disturbance
        assert abs(bias) < 0.02 * limit
        assert coulomb >= 0.0
