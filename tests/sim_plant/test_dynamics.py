"""Every effect of the real stage against an independent integrator or a closed form that shares no line with it."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim_plant.config import PlantConfig
from sim_plant.physics.dynamic_batch import take
from sim_plant.physics.events import dynamics_of
from sim_plant.physics.real_axes import kinds_of, structure_of
from sim_plant.physics.stage import Stage, Truth
from sim_plant.physics.structure import Motion

MS = 1_000_000
X = {"mass": [0.93], "coulomb": [0.66], "viscous": [3.2], "quadratic": [0.0]}  # the microscope's X
FREE = {"mass": [0.5], "coulomb": [0.0], "viscous": [0.0], "quadratic": [0.0]}
PAPER_X = {"mass": [0.02218], "coulomb": [1.146], "viscous": [-0.04749], "quadratic": [0.00265]}


def stage_of(velocity: float = 0.0, **keys: Any) -> Stage:
    return Stage(Truth.from_config(PlantConfig(**keys), 1, ["x"]), 0.0, velocity)


def mode(frequency: float, damping: float = 0.02, load: float = 0.3) -> dict[str, Any]:
    return {"modes": [{"axis": "x", "frequency_hz": frequency, "damping": damping, "load": load}]}


class Reference:
    """LuGre friction, two masses and a lag as one stiff system, by scipy's implicit Radau method."""

    def __init__(self, plant: PlantConfig) -> None:
        self.y = np.zeros(6)  # motor position and velocity, bristle, force, load position and velocity
        self.m, self.c = plant.mass[0], plant.coulomb[0]
        self.viscous, self.quadratic = plant.viscous[0], plant.quadratic[0]
        self.reach = float(plant.presliding)  # type: ignore[arg-type]
        self.s0 = self.c / self.reach
        self.s1 = 2 * float(plant.presliding_damping) * math.sqrt(self.s0 * self.m)  # type: ignore[arg-type]
        self.peak, self.vs = float(plant.stribeck_scale), float(plant.stribeck_velocity)  # type: ignore[arg-type]
        self.lag = float(plant.torque_lag)  # type: ignore[arg-type]
        self.m2 = self.m * plant.modes[0].load if plant.modes else 0.0
        ring = 2 * math.pi * plant.modes[0].frequency_hz if plant.modes else 0.0
        self.k = self.m2 * ring**2
        self.d = 2 * plant.modes[0].damping * ring * self.m2 if plant.modes else 0.0

    def slope(self, force: float, y: np.ndarray) -> list[float]:
        q, v, z, lagged, load, u = y
        limit = self.reach * (1 + self.peak / (1 + (v / self.vs) ** 2))
        rate = v - abs(v) * z / limit
        friction = self.s0 * z + self.s1 * rate + self.viscous * v + self.quadratic * v * abs(v)
        coupling = self.k * (load - q) + self.d * (u - v)
        drive = lagged if self.lag else force
        a = (drive - friction + coupling) / (self.m - self.m2)
        b = -coupling / self.m2 if self.m2 else 0.0
        return [v, a, rate, (force - lagged) / self.lag if self.lag else 0.0, u, b]

    def advance(self, seconds: float, force: float) -> None:
        solution = solve_ivp(
            lambda _t, y: self.slope(force, y),
            (0, seconds),
            self.y,
            method="Radau",
            rtol=1e-9,
            atol=[1e-14, 1e-12, 1e-15, 1e-10, 1e-14, 1e-12],
        )
        self.y = solution.y[:, -1]

    @property
    def tool(self) -> float:
        return float(self.y[4] if self.m2 else self.y[0])


CASES: dict[str, tuple[dict[str, Any], float]] = {  # with the amplitude of the force
    "1 um, breaking loose and turning": ({**X, "presliding": 1e-6}, 1.1),
    "1 um, stuck": ({**X, "presliding": 1e-6}, 0.5),
    "10 um": ({**X, "presliding": 1e-5}, 1.1),
    "0.3 um": ({**X, "presliding": 3e-7}, 1.1),
    "undamped bristle": ({**X, "presliding": 1e-5, "presliding_damping": 0.0}, 0.9),
    "lag": ({**X, "presliding": 1e-6, "torque_lag": 3e-4}, 1.1),
    "mode of 200 Hz": ({**X, "presliding": 1e-6, **mode(200.0)}, 1.1),
    "mode, lag, Stribeck": (
        {**X, "presliding": 1e-5, **mode(300.0), "torque_lag": 1e-4, "stribeck_scale": 0.1, "stribeck_velocity": 0.005},
        1.1,
    ),
    "narrow Stribeck peak": ({**X, "presliding": 1e-6, "stribeck_scale": 0.3, "stribeck_velocity": 1e-3}, 1.3),
    "undamped mode": ({**X, "presliding": 1e-6, **mode(200.0, 0.001)}, 1.1),
    "half a millimetre": ({**X, "presliding": 1e-6}, 3.0),
    "the paper's X": ({**PAPER_X, "presliding": 1e-6}, 2.0),
    "the paper's X on a mode": ({**PAPER_X, "presliding": 1e-6, "torque_lag": 1e-4, **mode(200.0)}, 2.0),
}


def allowed(travel: float) -> float:
    """m: a nanometre, and more only for the paper's X, which travels millimetres at 100 m/s^2."""
    return max(1e-9, 1e-6 * travel)


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=pytest.mark.slow) if case == "the paper's X on a mode" else case for case in CASES],
)
def test_agrees_with_an_implicit_integrator_to_a_nanometre(case: str) -> None:
    keys, amplitude = CASES[case]
    plant = PlantConfig(**keys)
    stage, reference = Stage(Truth.from_config(plant, 1, ["x"])), Reference(plant)
    travel = 0.0
    for i in range(60):
        force = amplitude * math.sin(2 * math.pi * i / 40)
        stage.advance(MS, [force])
        reference.advance(1e-3, force)
        travel = max(travel, abs(reference.tool))
        assert abs(stage.positions[0] - reference.tool) < allowed(travel)
        assert abs(stage.readings()[0] - reference.y[0]) < allowed(travel)
    assert travel > 5e-7


@pytest.mark.parametrize("case", CASES)
def test_the_answer_does_not_depend_on_how_time_is_divided(case: str) -> None:
    keys, amplitude = CASES[case]
    coarse, fine, travel = stage_of(**keys), stage_of(**keys), 0.0
    for i in range(60):
        force = [amplitude * math.sin(2 * math.pi * i / 40)]
        coarse.advance(MS, force)
        for _ in range(8):
            fine.advance(MS // 8, force)
        travel = max(travel, abs(fine.positions[0]))
        assert abs(coarse.positions[0] - fine.positions[0]) < allowed(travel)


PASSING: dict[str, tuple[dict[str, Any], float]] = {  # with the speed at which all but inertia is passed by
    "cogging": ({**FREE, "cogging": [{"axis": "x", "amplitude": 0.02, "period": 1e-4}]}, 0.4),
    "steep cogging": ({**FREE, "cogging": [{"axis": "x", "amplitude": 10.0, "period": 1e-4}]}, 0.1),
    "uneven friction": ({**X, "presliding": 1e-5, "friction_variation": 0.3, "friction_period": 1e-4}, 0.4),
    "a shaking floor": ({**FREE, "vibration": [{"axis": "x", "acceleration": 3.0, "frequency_hz": 2000.0}]}, 0.0),
    "a stiff cable": ({**FREE, "cable_stiffness": 2e6}, 0.01),
    "quadratic friction": ({**FREE, "quadratic": [40.0], "torque_lag": 1e-3}, 2.0),
}


@pytest.mark.parametrize("case", PASSING)
def test_what_is_passed_within_a_piece_is_seen_however_fast(case: str) -> None:
    keys, speed = PASSING[case]
    coarse, fine = stage_of(speed, **keys), stage_of(speed, **keys)
    for force in [0.1] * 10 + [-0.1] * 10:
        coarse.advance(MS, [force])
        for _ in range(16):
            fine.advance(MS // 16, [force])
        assert abs(coarse.positions[0] - fine.positions[0]) < 2e-9


def test_the_virgin_curve_and_the_loop_of_presliding_are_dahls() -> None:
    """Pulled slowly by a drive that outweighs inertia: friction = F (1 - exp(-x / D)), after a reversal doubled."""
    reach, f, top_force = 1e-5, 0.66, 0.7 * 0.66
    stage = stage_of(mass=[0.1], coulomb=[f], viscous=[20.0], quadratic=[0.0], presliding=reach, presliding_damping=0.7)
    for i in range(1000):  # slowly up to 0.7 F
        stage.advance(2 * MS, [top_force * (i + 1) / 1000])
    top = stage.positions[0]
    assert top == pytest.approx(-reach * math.log(1 - 0.7), rel=0.02)
    for i in range(2000):  # and back to -0.7 F
        stage.advance(2 * MS, [top_force * (1 - 2 * (i + 1) / 2000)])
    # after the reversal: friction = -F + (0.7 F + F) exp(-(top - x) / D)
    assert top - stage.positions[0] == pytest.approx(-reach * math.log(0.3 / 1.7), rel=0.02)


def test_without_a_force_mechanical_energy_only_ever_falls() -> None:
    stage = stage_of(velocity=5e-3, **X, presliding=1e-6, **mode(200.0))
    m2 = 0.3 * 0.93
    k, s0, before = m2 * (2 * math.pi * 200) ** 2, 0.66 / 1e-6, math.inf
    for _ in range(200):
        stage.advance(MS // 4, [0.0])
        s = Motion(*(float(array[0]) for array in stage._motions()))
        energy = 0.5 * (
            (0.93 - m2) * s.velocity**2
            + m2 * s.load_velocity**2
            + k * (s.load_position - s.position) ** 2
            + s0 * s.bristle**2
        )
        assert energy <= before * (1 + 1e-9) + 1e-18
        before = energy


def test_a_lagged_step_of_force_moves_a_free_mass_as_the_closed_form_says() -> None:
    for lag in (2e-5, 3e-4, 2e-3):
        stage = stage_of(**FREE, torque_lag=lag)
        for i in range(1, 11):
            stage.advance(MS, [0.2])
            t = i * 1e-3
            expected = 0.2 / 0.5 * (t * t / 2 - lag * t + lag * lag * (1 - math.exp(-t / lag)))
            assert stage.positions[0] == pytest.approx(expected, rel=1e-6, abs=1e-11)


@pytest.mark.parametrize("damper", ["viscous", "drag"])
def test_a_damper_that_is_quick_against_a_tick_is_followed_through_it(damper: str) -> None:
    """To a nanometre, as v = F / c + (v0 - F / c) exp(-c t / m) says; the drag is that of a cell pierced at once."""
    mass, c, force, begin = 0.05, 200.0, 10.0, 0.02
    pierced = [{"axis": "x", "surface": 0.0, "direction": 1, "puncture_depth": 1e-9, "stiffness": 1.0, "drag": c}]
    slowed: dict[str, Any] = {"viscous": [c]} if damper == "viscous" else {"viscous": [0.0], "cells": pierced}
    stage = stage_of(begin, mass=[mass], coulomb=[0.0], quadratic=[0.0], backlash=1e-12, **slowed)
    for i in range(1, 6):
        stage.advance(MS, [force])
        t, last = i * 1e-3, force / c
        expected = last * t + (begin - last) * (mass / c) * (1.0 - math.exp(-t * c / mass))
        assert stage.readings()[0] == pytest.approx(expected, abs=1e-9)


def test_a_free_axis_rings_at_the_frequency_and_damping_its_mode_says() -> None:
    """Two masses on a spring: relative motion at f / sqrt(1 - load), damped by damping / sqrt(1 - load)."""
    load, damping, force = 0.3, 0.03, 0.1
    stage = stage_of(**FREE, **mode(150.0, damping, load))
    ring = 2 * math.pi * 150.0 / math.sqrt(1 - load)
    ratio = damping / math.sqrt(1 - load)
    still = force / 0.5 / (2 * math.pi * 150.0) ** 2  # how far the tool lags under this acceleration
    damped = ring * math.sqrt(1 - ratio**2)
    for i in range(1, 61):
        stage.advance(MS, [force])
        t = i * 1e-3
        decay = math.exp(-ratio * ring * t)
        swing = decay * (math.cos(damped * t) + ratio * ring / damped * math.sin(damped * t))
        assert stage.positions[0] - stage.readings()[0] == pytest.approx(-still * (1 - swing), abs=1e-9)


def test_what_pulls_on_a_motor_that_friction_holds_is_the_sum_of_all_that_hangs_on_it() -> None:
    """And what friction can hold is the Coulomb force, its peak at rest, and how that varies with the place."""
    cable = {"cable_stiffness": 20.0, "cable_hysteresis": 0.05, "cable_reach": 1e-4}
    along = {"cogging": [{"amplitude": 0.2, "period": 0.01, "phase": 0.3}], "friction_variation": 0.1}
    along |= {"friction_period": 0.02, "stribeck_scale": 0.4, "stribeck_velocity": 0.01, "torque_lag": 1e-3}
    floor = {"vibration": [{"acceleration": 0.5, "frequency_hz": 30.0}]}
    hung = {"axis": "x", "frequency_hz": 450.0, "damping": 0.05, "load": 0.04}
    stage = stage_of(**X, modes=[*mode(200.0, 0.1)["modes"], hung], **cable, **along, **floor)
    structure = structure_of(stage.truth, np.zeros(1))
    axis = dynamics_of(take(structure, 0), int(kinds_of(stage.truth, structure)[0]))
    q, tool, speed, bent, lagged, t = 1.3e-3, 1.5e-3, -0.02, 0.4, 0.7, 0.011
    at = Motion(q, 0.0, 0.0, tool, speed, 0.0, bent, lagged, tool, 0.0, q - 2e-6, 0.01, q, 0.0, *[0.0] * 4)
    net, hold = axis.load_on_motor(at, t, (0.11, 9.0))
    ring = 2.0 * math.pi * 200.0
    coupling = 0.3 * 0.93 * (ring * ring * (tool - q) + 0.2 * ring * speed)
    ring = 2.0 * math.pi * 450.0
    coupling += 0.04 * 0.93 * (ring * ring * -2e-6 + 0.1 * ring * 0.01)
    pulls = coupling - 0.05 * bent - 20.0 * q + 0.2 * math.sin(2.0 * math.pi * q / 0.01 + 0.3)
    shaken = 0.66 * 0.93 * 0.5 * math.sin(2.0 * math.pi * 30.0 * t)
    assert net == pytest.approx(0.11 + lagged + pulls - shaken, rel=1e-9)
    assert hold == pytest.approx(0.66 * 1.4 * (1.0 + 0.1 * math.sin(2.0 * math.pi * q / 0.02)), rel=1e-9)


def test_a_mode_on_set_valued_friction_lets_the_tool_ring_while_the_motor_is_held() -> None:
    stage = stage_of(velocity=5e-3, **X, **mode(200.0))
    for _ in range(30):
        stage.advance(MS, [0.0])
    stuck = stage.readings()[0]
    tool = []
    for _ in range(200):
        stage.advance(MS // 10, [0.0])
        assert stage.readings()[0] == stuck
        tool.append(stage.positions[0] - stuck)
    crossings = np.flatnonzero(np.diff(np.sign(tool)))
    assert np.ptp(tool) > 1e-8
    assert (crossings[-1] - crossings[0]) / (len(crossings) - 1) == pytest.approx(10_000 / 400.0, rel=0.05)


def test_a_breakaway_under_a_lagged_force_happens_when_the_force_says() -> None:
    """The force passes the dry friction at -lag log(1 - F / u); from then on the mass accelerates."""
    lag, u, friction = 1e-3, 1.0, 0.66
    stage = stage_of(mass=[0.93], coulomb=[friction], viscous=[0.0], quadratic=[0.0], torque_lag=lag)
    start = -lag * math.log(1 - friction / u)
    for i in range(1, 6):
        stage.advance(MS, [u])
        t = max(0.0, i * 1e-3 - start)
        free = u * (1 - friction / u)  # net force left over, decaying into u - friction
        expected = ((u - friction) * t * t / 2 - free * (lag * t - lag * lag * (1 - math.exp(-t / lag)))) / 0.93
        assert stage.positions[0] == pytest.approx(expected, abs=1e-9)


def test_cogging_cable_and_varying_friction_balance_where_they_should() -> None:
    cable = stage_of(**{**FREE, "viscous": [50.0]}, cable_stiffness=20.0)
    for _ in range(4000):
        cable.advance(10 * MS, [0.1])
    assert cable.positions[0] == pytest.approx(0.1 / 20.0, rel=1e-6)

    loop = stage_of(**{**FREE, "viscous": [5.0]}, cable_hysteresis=0.05, cable_reach=1e-4)
    loop.advance(1000 * MS, [0.3])
    assert loop.velocities[0] == pytest.approx((0.3 - 0.05) / 5.0, rel=1e-4)
    loop.advance(1000 * MS, [-0.3])
    assert loop.velocities[0] == pytest.approx(-(0.3 - 0.05) / 5.0, rel=1e-4)

    trap = stage_of(**{**FREE, "viscous": [20.0]}, cogging=[{"amplitude": 0.2, "period": 0.01, "phase": math.pi / 2}])
    for _ in range(500):
        trap.advance(10 * MS, [0.0])
    assert trap.positions[0] == pytest.approx(0.0025, abs=1e-9)  # cos falls through zero

    for phase, factor in ((math.pi / 2, 1.3), (-math.pi / 2, 0.7)):
        keys = {**X, "friction_variation": 0.3, "friction_phase": phase}
        for push, moves in ((factor * 0.66 * 0.999, False), (factor * 0.66 * 1.001, True)):
            stage = stage_of(**keys)
            stage.advance(5 * MS, [push])
            assert (stage.positions[0] != 0.0) is moves


def test_the_floor_shakes_a_free_axis_by_its_acceleration_over_the_square_of_its_frequency() -> None:
    stage = stage_of(**FREE, vibration=[{"acceleration": 0.2, "frequency_hz": 40.0}])
    w = 2 * math.pi * 40.0
    for i in range(1, 101):
        stage.advance(MS, [0.0])
        t = i * 1e-3
        assert stage.positions[0] == pytest.approx(0.2 / w**2 * (math.sin(w * t) - w * t), abs=1e-9)


def test_the_floor_drives_a_tool_on_its_mode_as_the_frequency_response_says() -> None:
    held = {"mass": [0.5], "coulomb": [100.0], "viscous": [0.0], "quadratic": [0.0]}
    stage = stage_of(**held, **mode(100.0, 0.1), vibration=[{"acceleration": 1.0, "frequency_hz": 60.0}])
    stage.advance(500 * MS, [0.0])
    swing = []
    for _ in range(500):
        stage.advance(MS // 5, [0.0])
        swing.append(stage.positions[0])
    w, n = 2 * math.pi * 60.0, 2 * math.pi * 100.0
    expected = 1.0 / abs(n * n - w * w + 2j * 0.1 * n * w)
    assert max(swing) == pytest.approx(expected, rel=2e-3)


def test_backlash_drift_and_bias_do_what_their_names_say() -> None:
    stage = stage_of(**{**FREE, "viscous": [5.0]}, backlash=2e-6, drift=1e-6)
    for force, side in ((0.1, -1e-6), (-0.1, 1e-6)):
        for _ in range(20):
            stage.advance(100 * MS, [force])
        t = stage._elapsed_ns * 1e-9
        assert stage.positions[0] - stage.readings()[0] == pytest.approx(side + 1e-6 * t, abs=1e-15)
    pushed, biased = stage_of(**X), stage_of(**X, bias=0.9)
    pushed.advance(20 * MS, [0.9])
    biased.advance(20 * MS, [0.0])
    assert pushed.positions == biased.positions != [0.0]


def test_a_braked_axis_with_presliding_stays_and_comes_free_again() -> None:
    stage = stage_of(mass=[0.25], coulomb=[0.2], viscous=[1.0], quadratic=[0.0], gravity=[-2.5], presliding=1e-6)
    stage.clamp(50.0)
    stage.advance(1000 * MS, [0.0])
    assert abs(stage.positions[0]) < 5e-6
    stage.clamp(0.0)
    stage.advance(100 * MS, [0.0])
    assert stage.velocities[0] < -0.5


class Driven(Reference):
    """The same axis with forces along the travel and in time as well, as one stiff system with the cable's state."""

    def __init__(self, plant: PlantConfig) -> None:
        super().__init__(plant)
        self.y = np.append(self.y, [0.0, 0.0])  # the cable's state, and time
        self.plant = plant

    def slope(self, force: float, y: np.ndarray) -> list[float]:
        q, v, z, _, _, _, strained, time = y
        p, turn = self.plant, 2 * math.pi
        rate = v - abs(v) * z / self.reach
        scale = 1 + float(p.friction_variation) * math.sin(turn * q / float(p.friction_period))  # type: ignore[arg-type]
        friction = scale * (self.s0 * z + self.s1 * rate) + self.viscous * v
        pull = sum(line.amplitude * math.sin(turn * q / line.period + line.phase) for line in p.cogging)
        pull -= float(p.cable_stiffness) * q + float(p.cable_hysteresis) * strained  # type: ignore[arg-type]
        floor = sum(line.acceleration * math.sin(turn * line.frequency_hz * time) for line in p.vibration)
        bent = (v - abs(v) * strained) / float(p.cable_reach)  # type: ignore[arg-type]
        return [v, (force + float(p.bias) + pull - friction) / self.m - floor, rate, 0.0, 0.0, 0.0, bent, 1.0]  # type: ignore[arg-type]

    def advance(self, seconds: float, force: float) -> None:
        atol = [1e-14, 1e-12, 1e-15, 1.0, 1.0, 1.0, 1e-10, 1e-12]
        system = solve_ivp(lambda _t, y: self.slope(force, y), (0, seconds), self.y, "Radau", rtol=1e-9, atol=atol)
        self.y = system.y[:, -1]


@pytest.mark.parametrize(
    "effect",
    [
        {"cogging": [{"amplitude": 0.1, "period": 1e-3, "phase": 0.4}, {"amplitude": 0.03, "period": 4e-4}]},
        {"friction_variation": 0.3, "friction_period": 1e-3},
        {"cable_stiffness": 500.0, "cable_hysteresis": 0.05, "cable_reach": 2e-4},
        {"vibration": [{"acceleration": 0.3, "frequency_hz": 40.0}]},
        {"bias": 0.2},
    ],
    ids=lambda effect: next(iter(effect)),
)
def test_forces_along_the_travel_and_in_time_agree_with_an_implicit_integrator(effect: dict[str, Any]) -> None:
    """In motion, through two reversals, to a nanometre or 1e-4 of the travel; and however time is divided."""
    plant = PlantConfig(**X, presliding=1e-5, **effect)
    truth = Truth.from_config(plant, 1, ["x"])
    stage, fine, reference, plain = Stage(truth), Stage(truth), Driven(plant), stage_of(**X, presliding=1e-5)
    told, travel = 0.0, 0.0
    for i in range(50):
        force = 1.4 * math.sin(2 * math.pi * i / 40)
        stage.advance(MS, [force])
        plain.advance(MS, [force])
        for _ in range(4):
            fine.advance(MS // 4, [force])
        reference.advance(1e-3, force)
        told = max(told, abs(stage.positions[0] - plain.positions[0]))
        travel = max(travel, abs(stage.positions[0]))
        assert abs(stage.positions[0] - reference.y[0]) < max(1e-9, 1e-4 * travel)
        assert abs(stage.positions[0] - fine.positions[0]) < max(1e-9, 1e-4 * travel)
    assert travel > 5e-5
    assert told > 1e-7  # the effect shows
