"""Axes with several resonances: masses hung on the motor beside the tool's, against matrices and integrators apart."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.integrate import solve_ivp
from scipy.linalg import eigh, expm

from sim_plant.config import PlantConfig
from sim_plant.physics.stage import Stage, Truth

Array = NDArray[np.float64]
MS = 1_000_000
MASS = 0.93
X = {"mass": [MASS], "coulomb": [0.66], "viscous": [3.2], "quadratic": [0.0]}
FREE = {"mass": [MASS], "coulomb": [0.0], "viscous": [0.0], "quadratic": [0.0]}
HZ, DAMPING, LOAD = (150.0, 320.0, 447.0), (0.02, 0.005, 0.01), (0.3, 0.08, 0.02)


def modes(count: int, *, damped: bool = True, tool: bool = True) -> list[dict[str, Any]]:
    rows = list(zip(HZ, DAMPING, LOAD, strict=True))[:count]
    return [{"axis": "x", "frequency_hz": f, "damping": d * damped, "load": part, "tool": tool} for f, d, part in rows]


def stage_of(velocity: float = 0.0, **keys: Any) -> Stage:
    return Stage(Truth.from_config(PlantConfig(**keys), 1, ["x"]), 0.0, velocity)


def matrices(count: int, damped: bool = True) -> tuple[Array, Array, Array]:
    """Mass, stiffness and damping of motor, tool and the others, in this order."""
    own = MASS * np.array(LOAD[:count])
    ring = 2.0 * math.pi * np.array(HZ[:count])
    mass = np.diag([MASS - own.sum(), *own])
    stiffness, damping = np.zeros((count + 1, count + 1)), np.zeros((count + 1, count + 1))
    for i, (m, w, ratio) in enumerate(zip(own, ring, DAMPING, strict=False), start=1):
        pair = np.zeros(count + 1)
        pair[[0, i]] = 1.0, -1.0
        stiffness += m * w * w * np.outer(pair, pair)
        damping += damped * 2.0 * ratio * w * m * np.outer(pair, pair)
    return mass, stiffness, damping


@pytest.mark.parametrize("count", [2, 3])
def test_a_free_axis_rings_at_the_eigenfrequencies_of_its_matrices_and_at_no_other(count: int) -> None:
    stage = stage_of(**FREE, modes=modes(count, damped=False))
    stage.advance(MS, [0.5])
    step_ns, seen = MS // 4, []
    for _ in range(2000):
        stage.advance(step_ns, [0.0])
        seen.append((stage.readings()[0], stage.positions[0]))
    shown, t = np.array(seen), np.arange(2000) * step_ns * 1e-9
    mass, stiffness, _ = matrices(count, damped=False)
    ring = np.sqrt(eigh(stiffness, mass, eigvals_only=True)[1:])

    def left(rings: Array) -> float:
        waves = [wave(w * t) for w in rings for wave in (np.cos, np.sin)]
        columns = np.stack([np.ones_like(t), t, *waves], axis=1)
        _, rest, _, _ = np.linalg.lstsq(columns, shown, rcond=None)
        return float(np.sqrt(rest.max() / len(t)))

    assert left(ring) < 2e-10  # m
    for index in range(count):
        other = ring.copy()
        other[index] *= 1.002
        assert left(other) > 1e-9


@pytest.mark.parametrize(("count", "tool"), [(1, True), (2, True), (3, True), (1, False), (2, False)])
def test_a_free_axis_moves_under_steps_of_force_as_its_matrices_say(count: int, tool: bool) -> None:
    mass, stiffness, damping = matrices(count)
    n = count + 1
    system = np.zeros((2 * n + 1, 2 * n + 1))
    system[:n, n : 2 * n] = np.eye(n)
    system[n : 2 * n, :n] = -np.linalg.solve(mass, stiffness)
    system[n : 2 * n, n : 2 * n] = -np.linalg.solve(mass, damping)
    system[n, -1] = 1.0 / mass[0, 0]
    over = expm(system * 1e-3)
    stage, state = stage_of(**FREE, modes=modes(count, tool=tool)), np.zeros(2 * n + 1)
    for i in range(200):
        state[-1] = 0.4 * math.sin(0.7 * i) + 0.3 * (-1) ** i
        stage.advance(MS, [state[-1]])
        state = over @ state
        assert stage.readings()[0] == pytest.approx(state[0], abs=1e-9)
        assert stage.positions[0] == pytest.approx(state[1 if tool else 0], abs=1e-9)
        motion = stage._motions()
        others = [motion.second_position, motion.third_position][: count - tool]
        assert [float(other[0]) for other in others] == pytest.approx(state[1 + tool : n].tolist(), abs=2e-9)


def test_without_a_force_mechanical_energy_only_ever_falls() -> None:
    stage = stage_of(velocity=5e-3, **X, presliding=1e-6, modes=modes(3))
    mass, stiffness, _ = matrices(3)
    before = begun = 0.5 * MASS * 5e-3**2
    for _ in range(400):
        stage.advance(MS // 4, [0.0])
        m = stage._motions()
        q = np.concatenate([m.position, m.load_position, m.second_position, m.third_position])
        v = np.concatenate([m.velocity, m.load_velocity, m.second_velocity, m.third_velocity])
        energy = 0.5 * float(v @ mass @ v + q @ stiffness @ q + 0.66 / 1e-6 * m.bristle[0] ** 2)
        assert energy <= before * (1 + 1e-9) + 1e-18
        before = energy
    assert before < 1e-3 * begun


class Reference:
    """LuGre friction, a lag, four masses and a shaking floor as one stiff system, by scipy's Radau method."""

    def __init__(self, presliding: float, lag: float, floor: tuple[float, float]) -> None:
        self.y = np.zeros(10)  # of motor, tool and the others: positions, velocities; bristle, force
        self.time = 0.0
        self.presliding, self.lag, self.floor = presliding, lag, floor
        self.mass, self.stiffness, self.damping = matrices(3)

    def slope(self, time: float, force: float, y: Array) -> Array:
        q, v, z, lagged = y[:4], y[4:8], y[8], y[9]
        rate = v[0] - abs(v[0]) * z / self.presliding
        s0 = 0.66 / self.presliding
        s1 = 2 * 0.2 * math.sqrt(s0 * MASS)
        pulls = -self.stiffness @ q - self.damping @ v
        pulls[0] += lagged - s0 * z - s1 * rate - 3.2 * v[0]
        size, hertz = self.floor
        shaken = size * math.sin(2 * math.pi * hertz * time)
        return np.concatenate([v, pulls / np.diag(self.mass) - shaken, [rate, (force - lagged) / self.lag]])

    def advance(self, seconds: float, force: float) -> None:
        span = (self.time, self.time + seconds)
        atol = [1e-14] * 4 + [1e-12] * 4 + [1e-15, 1e-10]
        found = solve_ivp(lambda t, y: self.slope(t, force, y), span, self.y, "Radau", rtol=1e-9, atol=atol)
        self.y, self.time = found.y[:, -1], span[1]


def test_three_modes_under_presliding_lag_and_a_shaking_floor_agree_with_an_implicit_integrator() -> None:
    floor = {"acceleration": 0.1, "frequency_hz": 40.0}
    stage = stage_of(**X, presliding=1e-5, torque_lag=3e-4, modes=modes(3), vibration=[floor])
    reference, travel = Reference(1e-5, 3e-4, (0.1, 40.0)), 0.0
    for i in range(50):
        force = 1.1 * math.sin(2 * math.pi * i / 40)
        stage.advance(MS, [force])
        reference.advance(1e-3, force)
        travel = max(travel, abs(float(reference.y[1])))
        assert stage.readings()[0] == pytest.approx(reference.y[0], abs=1e-9)
        assert stage.positions[0] == pytest.approx(reference.y[1], abs=1e-9)
    assert travel > 1e-5


def test_while_friction_holds_the_motor_each_mass_rings_at_its_own_frequency() -> None:
    stage = stage_of(velocity=5e-3, **X, modes=modes(3))
    for _ in range(30):
        stage.advance(MS, [0.0])
    stuck, seen = stage.readings()[0], []
    for _ in range(1000):
        stage.advance(MS // 20, [0.0])
        assert stage.readings()[0] == stuck
        m = stage._motions()
        seen.append([float(a[0]) - stuck for a in (m.load_position, m.second_position, m.third_position)])
    for swing, hertz in zip(np.array(seen).T, HZ, strict=True):
        crossings = np.flatnonzero(np.diff(np.sign(swing)))
        assert np.ptp(swing) > 1e-9
        assert (crossings[-1] - crossings[0]) / (len(crossings) - 1) == pytest.approx(10_000 / hertz, rel=0.02)


def test_a_held_motor_comes_loose_by_what_the_other_masses_pull() -> None:
    """Their ring adds to the drive's force: with it, friction that would just hold lets go."""
    shaken = {"vibration": [{"acceleration": 0.6, "frequency_hz": 310.0}]}
    ends = []
    for count in (1, 2):
        stage = stage_of(**X, modes=modes(count), **shaken)
        for _ in range(100):
            stage.advance(MS, [0.0])
        ends.append(stage.readings()[0])
    assert ends[0] == 0.0
    assert ends[1] != 0.0


def test_one_entry_carries_the_tool_and_an_axis_with_entries_of_its_own_takes_no_others() -> None:
    own = modes(3)
    own = [own[1] | {"tool": False}, own[0], own[2]]
    mixed = [*own, {"frequency_hz": 90.0, "load": 0.2}, {"frequency_hz": 200.0, "load": 0.05}]
    keys = {key: [*value, *value] for key, value in X.items()}
    truth = Truth.from_config(PlantConfig(**keys, modes=mixed), 2, ["x", "y"])
    assert truth.mode_frequency.tolist() == [150.0, 90.0]
    assert truth.mode_load.tolist() == [0.3, 0.2]
    assert truth.other_modes["frequency"].tolist() == [[320.0, 447.0], [200.0, 0.0]]
    assert truth.other_modes["load"].tolist() == [[0.08, 0.02], [0.05, 0.0]]
    assert truth.other_modes["damping"].tolist() == [[0.005, 0.01], [0.02, 0.0]]


def test_too_many_modes_and_too_much_mass_on_them_are_refused_by_axis_and_value() -> None:
    with pytest.raises(ValidationError, match=r"modes: more than 3 on axis x; allowed per axis: at most 3"):
        PlantConfig(**X, modes=[*modes(3), *modes(1)])
    with pytest.raises(ValidationError, match=r"modes: 3 on axis x have tool = false; allowed: 2"):
        PlantConfig(**X, modes=modes(3, tool=False))
    heavy = [{"axis": "x", "frequency_hz": 100.0, "load": 0.5}] * 2
    with pytest.raises(ValidationError, match=r"modes: load of axis x is 1 together; allowed: at most 0\.95"):
        PlantConfig(**X, modes=heavy)
    PlantConfig(**X, modes=[{"axis": "x", "frequency_hz": 100.0, "load": part} for part in (0.65, 0.2, 0.1)])
    truth = Truth.from_config(PlantConfig(**X, modes=modes(3)), 1, ["x"])
    assert truth.changed(0, "mode_load", 0.9)[0].mode_load[0] == pytest.approx(0.95 - 0.08 - 0.02)


def test_masses_that_come_later_begin_where_the_motor_is() -> None:
    bare, hung = (
        Truth.from_config(PlantConfig(**X, torque_lag=1e-4, modes=found), 1, ["x"]) for found in ([], modes(3))
    )
    for stage in (Stage(bare), Stage(Truth.stack([bare] * 2))):
        for _ in range(20):
            stage.advance(MS, np.broadcast_to([2.0], stage.truth.shape))
        there = float(stage.position.flat[0])
        stage.change(hung if stage.truth is bare else Truth.stack([hung] * 2))
        motion = stage._motions()
        assert float(motion.second_position.flat[0]) == float(motion.third_position.flat[0]) == there != 0.0
