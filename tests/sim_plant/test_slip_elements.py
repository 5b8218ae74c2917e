"""Maxwell-slip friction against closed forms and an integrator of small steps that shares no line with it."""

import itertools
import math
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from pydantic import ValidationError

from sim_plant.config import PlantConfig
from sim_plant.native import library
from sim_plant.physics.stage import Stage, Truth

MS = 1_000_000
MASS, COULOMB, VISCOUS = 0.93, 0.66, 3.2
X = {"mass": [MASS], "coulomb": [COULOMB], "viscous": [VISCOUS], "quadratic": [0.0]}
PARTS = [(8.0, 1.0), (4.0, 2.0), (2.0, 3.0), (1.0, 4.0)]  # stiffness and limit, in proportion
WHOLE = [sum(part) for part in zip(*PARTS, strict=True)]
SLIP = [{"axis": "x", "stiffness": stiffness, "limit": limit} for stiffness, limit in PARTS]


def stage_of(velocity: float = 0.0, **keys: Any) -> Stage:
    return Stage(Truth.from_config(PlantConfig(**keys), 1, ["x"]), 0.0, velocity)


def elements(presliding: float) -> list[tuple[float, float]]:
    """Stiffness (N/m) and limit (N) of each."""
    whole = COULOMB / presliding
    return [(whole * k / WHOLE[0], COULOMB * f / WHOLE[1]) for k, f in PARTS]


class Reference:
    """The same axis by the midpoint rule in steps of a microsecond; each spring is cut off at its limit."""

    STEP = 1e-6

    def __init__(self, presliding: float, damping: float, peak: float = 0.0, width: float = 1.0) -> None:
        self.x = self.v = 0.0
        self.springs = elements(presliding)
        self.damping = 2 * damping * math.sqrt(COULOMB / presliding * MASS)
        self.peak, self.width = peak, width
        self.forces = [0.0] * len(self.springs)

    def moved(self, way: float, v: float) -> list[float]:
        high = 1 + self.peak / (1 + (v / self.width) ** 2)
        ends = zip(self.forces, self.springs, strict=True)
        return [min(max(force + k * way, -f * high), f * high) for force, (k, f) in ends]

    def acceleration(self, force: float, forces: list[float], v: float) -> float:
        high = COULOMB * (1 + self.peak / (1 + (v / self.width) ** 2))
        held = sum(forces)
        return (force - held - self.damping * (v - abs(v) * held / high) - VISCOUS * v) / MASS

    def advance(self, steps: int, force: float) -> None:
        h = self.STEP
        for _ in range(steps):
            v = self.v + 0.5 * h * self.acceleration(force, self.forces, self.v)
            a = self.acceleration(force, self.moved(0.5 * h * self.v, v), v)
            self.x, self.v, self.forces = self.x + h * v, self.v + h * a, self.moved(h * v, self.v + h * a)


CASES: dict[str, tuple[dict[str, Any], float]] = {  # with the amplitude of the force
    "1 um, breaking loose and turning": ({"presliding": 1e-6}, 1.1),
    "1 um, stuck": ({"presliding": 1e-6}, 0.4),
    "10 um": ({"presliding": 1e-5}, 1.1),
    "0.3 um": ({"presliding": 3e-7}, 1.1),
    "undamped": ({"presliding": 1e-5, "presliding_damping": 0.0}, 0.9),
    "Stribeck": ({"presliding": 1e-5, "stribeck_scale": 0.2, "stribeck_velocity": 5e-3}, 1.3),
    "a millimetre": ({"presliding": 1e-6}, 4.0),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.long
def test_agrees_with_small_steps_to_two_nanometres_and_however_time_is_divided(case: str) -> None:
    keys, amplitude = CASES[case]
    coarse, fine = stage_of(**X, **keys, slip=SLIP), stage_of(**X, **keys, slip=SLIP)
    peak = {"peak": keys["stribeck_scale"], "width": keys["stribeck_velocity"]} if case == "Stribeck" else {}
    reference, travel = Reference(keys["presliding"], keys.get("presliding_damping", 0.2), **peak), 0.0
    for i in range(50):
        force = amplitude * math.sin(2 * math.pi * i / 40)
        coarse.advance(MS, [force])
        for _ in range(8):
            fine.advance(MS // 8, [force])
        reference.advance(1000, force)
        travel = max(travel, abs(reference.x))
        allowed = max(2e-9, 3e-6 * travel)
        assert abs(coarse.positions[0] - fine.positions[0]) < allowed
        assert abs(coarse.positions[0] - reference.x) < allowed
    assert travel > 1e-7


def test_pulled_slowly_force_and_way_are_those_of_springs_that_slip_one_by_one() -> None:
    """By a drive that outweighs inertia; after a reversal the curve is the same, doubled (Masing)."""
    presliding, springs = 1e-5, elements(1e-5)

    def virgin(x: float) -> float:
        return sum(min(k * x, f) for k, f in springs)

    keys = {"mass": [0.1], "coulomb": [COULOMB], "viscous": [20.0], "quadratic": [0.0]}
    stage = stage_of(**keys, presliding=presliding, presliding_damping=0.7, slip=SLIP)
    top = 0.8 * COULOMB
    for i in range(1000):
        stage.advance(2 * MS, [top * (i + 1) / 1000])
    there = stage.positions[0]
    assert virgin(there) == pytest.approx(top, rel=0.01)
    for i in range(2000):
        force = top * (1 - 2 * (i + 1) / 2000)
        stage.advance(2 * MS, [force])
        if i % 500 == 499:
            assert top - 2 * virgin((there - stage.positions[0]) / 2) == pytest.approx(force, abs=0.02 * COULOMB)


def test_stuck_below_every_limit_it_is_a_mass_on_the_stiffness_at_rest() -> None:
    force = 0.3 * COULOMB / WHOLE[1]
    keys = {"mass": [MASS], "coulomb": [COULOMB], "viscous": [0.0], "quadratic": [0.0]}
    stage = stage_of(**keys, presliding=1e-5, presliding_damping=0.0, slip=SLIP)
    stiffness = COULOMB / 1e-5
    for i in range(1, 200):
        stage.advance(MS // 2, [force])
        expected = force / stiffness * (1 - math.cos(math.sqrt(stiffness / MASS) * i * 5e-4))
        assert stage.positions[0] == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("stribeck", [0.0, 0.3])
def test_sliding_steadily_friction_is_that_of_an_axis_without_elements(stribeck: float) -> None:
    keys = X | {"viscous": [30.0], "stribeck_scale": stribeck, "stribeck_velocity": 5e-3, "presliding": 1e-6}
    slipping, plain = stage_of(**keys, slip=SLIP), stage_of(**keys)
    for stage in (slipping, plain):
        stage.advance(5000 * MS, [0.9])
    assert slipping.velocities[0] == pytest.approx(plain.velocities[0], rel=1e-6)
    assert slipping.velocities[0] > 2e-3


def test_without_a_force_mechanical_energy_only_ever_falls() -> None:
    stage = stage_of(velocity=5e-3, **X, presliding=1e-6, slip=SLIP)
    before = begun = 0.5 * MASS * 5e-3**2 + sum(f * f / k for k, f in elements(1e-6))
    for _ in range(200):
        stage.advance(MS // 4, [0.0])
        motion = stage._motions()
        bent = [float(array[0]) for array in motion[-4:]]
        springs = zip(elements(1e-6), bent, strict=True)
        energy = 0.5 * (MASS * float(motion.velocity[0]) ** 2 + sum(k * z * z for (k, _), z in springs))
        assert energy <= before * (1 + 1e-9) + 1e-18
        before = energy
    assert 0.0 < before < 0.05 * begun


def test_a_brake_that_grips_and_lets_go_leaves_each_element_its_force() -> None:
    stage = stage_of(**X, presliding=1e-5, presliding_damping=0.7, slip=SLIP)
    for i in range(100):
        stage.advance(10 * MS, [0.6 * COULOMB * min((i + 1) / 50, 1.0)])
    held = stage.positions[0]
    assert held > 1e-6
    for clamp in (50.0, 0.0, 50.0, 0.0):
        stage.clamp([clamp])
        stage.advance(20 * MS, [0.6 * COULOMB])
        assert stage.positions[0] == pytest.approx(held, abs=1e-9)


def test_elements_that_come_later_take_over_the_bristles_force() -> None:
    keys = {**X, "presliding": 1e-5, "presliding_damping": 0.7}
    truths = [Truth.from_config(PlantConfig(**keys, slip=found), 1, ["x"]) for found in ([], SLIP, [])]
    stage = Stage(truths[0])
    for _ in range(100):
        stage.advance(10 * MS, [0.05 * COULOMB])
    held = stage.positions[0]
    for truth in truths[1:]:
        stage.change(truth)
        stage.advance(20 * MS, [0.05 * COULOMB])
        assert stage.positions[0] == pytest.approx(held, abs=1e-9)


def test_a_batch_and_the_kernel_have_the_bits_of_one_stage_in_python() -> None:
    """Also under brakes, beside axes of other kinds, and with more effects."""
    counts = [(4, {}), (2, {"torque_lag": 1e-4}), (1, {"stribeck_scale": 0.3}), (3, {"friction_variation": 0.3})]
    modes = [{"axis": "x", "frequency_hz": 200.0, "load": 0.3}, {"axis": "x", "frequency_hz": 430.0, "load": 0.05}]
    plants = [
        PlantConfig(**X, presliding=length, slip=SLIP[:count], modes=modes[:hung], **keys)
        for (count, keys), length, hung in itertools.product(counts, (1e-6, 1e-5), (0, 2))
    ]
    plants.append(PlantConfig(**X, presliding=1e-6))
    truths = [Truth.from_config(plant, 1, ["x"]) for plant in plants]
    batch, singles = Stage(Truth.stack(truths * 3)), [Stage(truth) for truth in truths]
    with patch.object(library, "kernel", return_value=None):
        pure = [Stage(truth) for truth in truths]
    seen = set()
    for clamp, force in itertools.product((0.0, 20.0, 0.0), (1.5, -1.2, 0.3, -2.0)):
        batch.clamp(clamp)
        batch.advance(MS, np.full(batch.truth.shape, force))
        for row, (stage, slow) in enumerate(zip(singles, pure, strict=True)):
            stage.clamp(clamp)
            with patch.object(library, "kernel", return_value=None):
                slow.clamp(clamp)
            stage.advance(MS, [force])
            slow.advance(MS, [force])
            assert stage.positions == slow.positions == batch.position[row].tolist()
            assert stage.velocities == slow.velocities == batch.velocity[row].tolist()
            assert stage._single.axes[0].state == slow._single.axes[0].state
            seen.add(stage.positions[0])
    assert len(seen) > 150


def test_elements_are_counted_and_ranged_and_need_presliding() -> None:
    keys = {key: [*value, *value] for key, value in X.items()}
    plant = PlantConfig(**keys, presliding=[1e-6, 2e-6], slip=[*SLIP[:2], {}])
    slip = Truth.from_config(plant, 2, ["x", "y"]).slip
    assert slip["stiffness"].tolist() == [pytest.approx([2 / 3, 1 / 3, 0, 0]), [1.0, 0.0, 0.0, 0.0]]
    assert slip["limit"].tolist() == [pytest.approx([1 / 3, 2 / 3, 0, 0]), [1.0, 0.0, 0.0, 0.0]]
    with pytest.raises(ValidationError, match=r"slip: more than 4 on axis x; allowed per axis: at most 4"):
        PlantConfig(**X, presliding=1e-6, slip=[*SLIP, SLIP[0]])
    with pytest.raises(ValueError, match=r"plant\.slip: axis x has plant\.presliding = 0; expected above 0"):
        Truth.from_config(PlantConfig(**X, slip=SLIP), 1, ["x"])
    for key, value in itertools.product(("stiffness", "limit"), (9e-4, 1001.0, math.nan)):
        with pytest.raises(ValidationError, match=key):
            PlantConfig(**X, presliding=1e-6, slip=[{"axis": "x", key: value}])
