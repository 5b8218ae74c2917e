"""The stage's physics against an independent integrator, against closed forms, and against itself in batches."""

import functools
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from sim_plant.config import CellConfig, PlantConfig
from sim_plant.physics import exact_trigonometry
from sim_plant.physics.exact_trigonometry import sin_turns, sin_turns_array, sincos_turns, sincos_turns_array
from sim_plant.physics.ideal_batch import FEW
from sim_plant.physics.stage import Stage, Truth

MS = 1_000_000
PAPER = {
    "x": {"mass": [0.02218], "coulomb": [1.146], "viscous": [-0.04749], "quadratic": [0.00265]},
    "y": {"mass": [0.011386], "coulomb": [0.172], "viscous": [0.04023], "quadratic": [-0.001473]},
}
EFFECTS = {
    "plain": {},
    "ripple": {"ripple_amplitude": 0.05, "ripple_period": 0.05},
    "stribeck": {"stribeck_scale": 0.2, "stribeck_velocity": 0.01},
}


def stage_of(plant: PlantConfig, velocity: float = 0.0) -> Stage:
    n = len(plant.mass)
    return Stage(Truth.from_config(plant, n, ["x", "y", "z", "t"][:n]), 0.0, velocity)


class Reference:
    """One axis by scipy's eighth-order method at its tightest tolerance, sign changes located as events."""

    def __init__(self, plant: PlantConfig, velocity: float) -> None:
        self.plant = plant
        self.position, self.velocity = 0.0, velocity
        self.error = float(plant.modelling_error)  # type: ignore[arg-type]
        self.hold = plant.coulomb[0] * (1 + float(plant.stribeck_scale)) + self.error  # type: ignore[arg-type]

    def net(self, position: float, force: float) -> float:
        amplitude, period = float(self.plant.ripple_amplitude), float(self.plant.ripple_period)  # type: ignore[arg-type]
        return force + amplitude * math.sin(2 * math.pi * position / period)

    def slope(self, force: float, sign: float) -> Callable[[float, np.ndarray], list[float]]:
        plant = self.plant
        peak = plant.coulomb[0] * float(plant.stribeck_scale)  # type: ignore[arg-type]

        def slope(_t: float, y: np.ndarray) -> list[float]:
            v = y[1]
            dry = plant.coulomb[0] + self.error + peak / (1 + (v / float(plant.stribeck_velocity)) ** 2)  # type: ignore[arg-type]
            friction = sign * (dry + plant.quadratic[0] * v * v) + plant.viscous[0] * v
            return [v, (self.net(y[0], force) - friction) / plant.mass[0]]

        return slope

    def advance(self, duration: float, force: float) -> None:
        t = 0.0
        while t < duration:
            net = self.net(self.position, force)
            sign = math.copysign(1, self.velocity) if self.velocity else math.copysign(abs(net) > self.hold, net)
            if sign == 0.0:
                return

            def stop(_t: float, y: np.ndarray, sign: float = sign) -> float:
                return float(y[1] * sign)

            stop.terminal, stop.direction = True, -1.0  # type: ignore[attr-defined]
            solution = solve_ivp(
                self.slope(force, sign),
                (t, duration),
                [self.position, self.velocity],
                method="DOP853",
                rtol=1e-13,
                atol=1e-15,
                events=stop if self.velocity else None,
            )
            t = float(solution.t[-1])
            self.position, self.velocity = solution.y[0, -1], solution.y[1, -1]
            if solution.status == 1:
                self.velocity = 0.0


def largest_difference(
    plant: PlantConfig, velocity: float, forces: list[float], piece_ns: int, damping: float = 0.0
) -> float:
    """m. damping: N s/m of feedback on either's own speed: X alone amplifies any rounding e^21 times in ten seconds."""
    stage, reference, worst = stage_of(plant, velocity=velocity), Reference(plant, velocity), 0.0
    for asked in forces:
        stage.advance(piece_ns, [asked + damping * (velocity - float(stage.velocity[0]))])
        reference.advance(piece_ns * 1e-9, asked + damping * (velocity - reference.velocity))
        worst = max(worst, abs(stage.position[0] - reference.position))
    return worst


@pytest.mark.parametrize("axis", PAPER)
@pytest.mark.parametrize("effect", EFFECTS)
def test_agrees_with_scipy_to_a_nanometre_over_ten_seconds(axis: str, effect: str) -> None:
    plant = PlantConfig(**PAPER[axis], **EFFECTS[effect])
    cruise = 1.146 - 0.05 if axis == "x" else 0.172 + 0.06  # about what keeps 1 m/s
    forces = [cruise + 0.02 * math.sin(i / 5) for i in range(100)]
    assert largest_difference(plant, 1.0, forces, 100 * MS, damping=0.1) < 1e-9


@pytest.mark.parametrize("axis", PAPER)
@pytest.mark.parametrize("effect", ["plain", "stribeck"])
def test_agrees_with_an_event_located_reference_through_sign_changes(axis: str, effect: str) -> None:
    plant = PlantConfig(**PAPER[axis], **EFFECTS[effect], modelling_error=0.3)
    amplitude = 2 * plant.coulomb[0] + 0.6
    forces = [amplitude * math.sin(2 * math.pi * i / 50) for i in range(150)]
    assert largest_difference(plant, 0.1, forces, 10 * MS) < 1e-9


def test_ripple_and_sign_changes_together_stay_within_a_nanometre_at_microscope_speeds() -> None:
    plant = PlantConfig(
        mass=[0.9], coulomb=[0.66], viscous=[3.2], quadratic=[0.0], **EFFECTS["ripple"], **EFFECTS["stribeck"]
    )
    forces = [1.2 * math.sin(2 * math.pi * i / 50) for i in range(150)]
    assert largest_difference(plant, 0.0, forces, 10 * MS) < 1e-9


def test_stops_where_the_closed_form_says_and_stays_there_without_chatter() -> None:
    stage = stage_of(PlantConfig(mass=[0.5], coulomb=[0.8], viscous=[0.0], quadratic=[0.0]), velocity=0.02)
    for _ in range(40):
        stage.advance(MS, [0.0])
    stopped = float(stage.position[0])
    assert stopped == pytest.approx(0.5 * 0.02**2 / (2 * 0.8), rel=1e-13)
    for force in (0.79, -0.79, 0.8, -0.8, 0.0):
        stage.advance(100 * MS, [force])
        assert (float(stage.velocity[0]), float(stage.position[0])) == (0.0, stopped)


def test_breaks_away_just_above_the_breakaway_force_in_the_direction_of_the_force() -> None:
    plant = PlantConfig(mass=[0.5], coulomb=[0.8], viscous=[0.0], quadratic=[0.0], modelling_error=0.3)
    for force, sign in ((1.1000001, 1.0), (-1.1000001, -1.0)):
        stage = stage_of(plant)
        stage.advance(MS, [force])
        assert np.sign(stage.velocity[0]) == sign
    held = stage_of(plant)
    held.advance(MS, [1.0999999])
    assert held.velocity[0] == 0.0


def test_friction_scale_leaves_the_modelling_error_alone() -> None:
    plant = PlantConfig(
        mass=[1.0],
        coulomb=[1.0],
        viscous=[0.4],
        quadratic=[0.2],
        modelling_error=0.3,
        friction_scale=0.0,
        mass_scale=2.0,
    )
    stage = stage_of(plant, velocity=1.0)
    stage.advance(MS, [0.0])
    assert stage.velocity[0] == pytest.approx(1.0 - 0.3 / 2.0 * 1e-3, rel=1e-14)


def test_a_brake_holds_what_gravity_would_pull_down() -> None:
    stage = stage_of(PlantConfig(mass=[0.25], coulomb=[0.2], viscous=[1.0], quadratic=[0.0], gravity=[-2.5]))
    stage.clamp(50.0)
    stage.advance(1000 * MS, [0.0])
    assert stage.position[0] == 0.0
    stage.clamp(0.0)
    stage.advance(MS, [0.0])
    assert stage.velocity[0] == pytest.approx(-(2.5 - 0.2) / 0.25 * 1e-3, rel=0.01)


def test_a_membrane_gives_way_at_its_puncture_depth_and_the_next_cell_is_whole() -> None:
    cell = CellConfig(axis="x", surface=0.0, direction=-1, stiffness=1e9, puncture_depth=1e-4, drag=2.0)
    plant = PlantConfig(mass=[0.1], coulomb=[0.0], viscous=[5.0], quadratic=[0.0], cells=[cell])
    stage = stage_of(plant)
    elastic_limit = 1e9 * 1e-4**3
    stage.advance(6000 * MS, [-0.9 * elastic_limit])
    assert stage.position[0] == pytest.approx(-((0.9 * elastic_limit / 1e9) ** (1 / 3)), rel=1e-6)
    assert stage.pierced[0] == 0.0
    stage.advance(2000 * MS, [-1.1 * elastic_limit])
    assert stage.pierced[0] == 1.0
    assert stage.velocity[0] == pytest.approx(-1.1 * elastic_limit / (5.0 + 2.0), rel=1e-6)  # only drag is left
    stage.advance(4000 * MS, [2 * elastic_limit])
    assert stage.position[0] > 0.0
    assert stage.pierced[0] == 0.0


def test_wrong_lengths_and_names_are_refused_by_key() -> None:
    with pytest.raises(ValueError, match=r"plant\.viscous has 3 values for 2 axes"):
        Truth.from_config(PlantConfig(mass=[1, 1], coulomb=[0, 0], viscous=[0, 0, 0], quadratic=[0, 0]), 2)
    plant = PlantConfig(mass=[1], coulomb=[0], viscous=[0], quadratic=[0], cells=[CellConfig(axis="q", surface=0.0)])
    with pytest.raises(ValueError, match="no axis 'q'; the axes are x"):
        Truth.from_config(plant, 1, ["x"])


plants = st.builds(
    lambda mass, coulomb, viscous, error, ripple, peak, gravity: PlantConfig(
        mass=[mass, 0.02],
        coulomb=[coulomb, 1.1],
        viscous=[viscous, -0.05],
        quadratic=[0.01, 0.002],
        modelling_error=error,
        ripple_amplitude=[0.0, ripple],
        stribeck_scale=[peak, 0.0],
        gravity=[gravity, 0.0],
        cells=[CellConfig(axis="x", surface=0.001, direction=1, stiffness=1e7, drag=0.1)],
    ),
    st.floats(0.01, 2.0),
    st.floats(0.0, 2.0),
    st.floats(0.0, 5.0),
    st.sampled_from([0.0, 0.3]),
    st.sampled_from([0.0, 0.1]),
    st.sampled_from([0.0, 0.3]),
    st.floats(-1.0, 1.0),
)
forces = st.lists(st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)), min_size=1, max_size=8)


@settings(max_examples=60, deadline=None)
@given(st.lists(plants, min_size=2, max_size=4), st.sampled_from([1, 2 * FEW]), forces, st.integers(1, 3 * MS))
def test_a_batch_is_bit_for_bit_its_members_one_by_one(
    members: list[PlantConfig], copies: int, pieces: list[tuple[float, float]], duration_ns: int
) -> None:
    members = members * copies  # few go one by one, many as arrays
    truths = [Truth.from_config(plant, 2, ["x", "y"]) for plant in members]
    batch, single = Stage(Truth.stack(truths)), [Stage(truth) for truth in truths[: len(members) // copies]]
    for piece in pieces:
        batch.advance(duration_ns, np.broadcast_to(piece, (len(members), 2)))
        for stage in single:
            stage.advance(duration_ns, list(piece))
    for row, stage in enumerate(single):
        assert batch.position[row].tobytes() == (stage.position + 0.0).tobytes()
        assert batch.velocity[row].tolist() == stage.velocity.tolist()
        assert batch.pierced[row].tolist() == stage.pierced.tolist()


@pytest.mark.parametrize("more", [{}, {"presliding": 1e-5, "drift": 1e-7, "encoder_latency": 3e-4}])
def test_each_encoder_alone_and_ahead_shows_what_all_of_them_show_then(more: dict[str, object]) -> None:
    plant = PlantConfig(mass=[0.5, 0.3], coulomb=[0.2, 0.1], viscous=[1.0, 2.0], quadratic=[0.0, 0.0], **more)
    truth = Truth.from_config(plant, 2, ["x", "y"])
    together, alone, ahead = (Stage(truth, velocity=[0.01, -0.02]) for _ in range(3))
    for _ in range(5):
        peeked = [ahead.peek_reading(MS, [0.3, -0.4], index) for index in (0, 1)]
        for stage in (together, alone, ahead):
            stage.advance(MS, [0.3, -0.4])
        assert together.readings() == [alone.reading(index) for index in (0, 1)] == peeked
        assert peeked[0] != peeked[1]
        for index in (0, 1):
            ahead.reading(index)


@settings(max_examples=50, deadline=None)
@given(plants, st.floats(-2.0, 2.0))
def test_looking_ahead_changes_nothing(plant: PlantConfig, force: float) -> None:
    truth = Truth.from_config(plant, 2, ["x", "y"])
    watched, alone = Stage(truth, velocity=0.01), Stage(truth, velocity=0.01)
    for _ in range(3):
        peeked = watched.peek(MS, [force, force])[0]
        watched.advance(MS, [force, force])
        alone.advance(MS, [force, force])
        assert peeked.tolist() == watched.position.tolist() == alone.position.tolist()


@settings(max_examples=50, deadline=None)
@given(st.floats(0.01, 1.0), st.floats(0.0, 2.0), st.floats(0.0, 3.0), st.floats(-1.0, 1.0))
def test_without_a_force_an_axis_only_ever_slows_down(
    mass: float, coulomb: float, viscous: float, velocity: float
) -> None:
    plant = PlantConfig(mass=[mass], coulomb=[coulomb], viscous=[viscous], quadratic=[0.1], **EFFECTS["stribeck"])
    stage = stage_of(plant, velocity=velocity)
    for _ in range(20):
        before = abs(stage.velocity[0])
        stage.advance(MS, [0.0])
        assert abs(stage.velocity[0]) <= before
        assert stage.velocity[0] * velocity >= 0.0


@given(st.floats(-1e6, 1e6))
def test_sine_and_cosine_are_right_to_the_last_bits_and_the_same_for_floats_and_arrays(turns: float) -> None:
    sine, cosine = sincos_turns(turns)
    exact = (np.longdouble(turns) - np.rint(np.longdouble(turns))) * 2 * np.longdouble("3.14159265358979323846264338")
    assert abs(sine - np.sin(exact)) < 4e-16
    assert abs(cosine - np.cos(exact)) < 4e-16
    sines, cosines = sincos_turns_array(np.array([turns, turns]))
    assert (sines[1], cosines[1]) == (sine, cosine)


def test_sine_and_cosine_are_taylors_series_to_the_last_coefficient_in_either_form() -> None:
    """The last terms are below the last bit of most angles: of many, some are rounded otherwise without them."""

    def series(first: int, last: int) -> tuple[float, ...]:
        return tuple((-1) ** (n // 2) / math.factorial(n) for n in range(last, first - 1, -2))

    sine, cosine = series(3, 17), series(4, 18)
    assert (sine, cosine) == (exact_trigonometry._SINE, exact_trigonometry._COSINE)
    for x in np.linspace(-math.pi / 4, math.pi / 4, 20_001).tolist():
        x2 = x * x
        odd, even = (functools.reduce(lambda total, c: c + x2 * total, terms) for terms in (sine, cosine))
        assert exact_trigonometry._sine(x) == x + x * (x2 * odd)
        assert exact_trigonometry._cosine(x) == 1.0 + x2 * (x2 * even - 0.5)


@given(st.lists(st.floats(-1e6, 1e6) | st.floats(-1.0, 1.0), min_size=1, max_size=9))
def test_the_sine_alone_has_the_bits_of_sine_and_cosine_together(turns: list[float]) -> None:
    together = [sincos_turns(angle)[0] for angle in turns]
    assert [sin_turns(angle) for angle in turns] == together
    assert sin_turns_array(np.array(turns)).tolist() == together


def test_a_batch_beyond_one_chunk_is_still_its_members(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim_plant.physics.stage.CHUNK", 5)
    kinds = [
        PlantConfig(**PAPER["x"], **effect, modelling_error=0.01 * i) for i in range(6) for effect in EFFECTS.values()
    ]
    truths = [Truth.from_config(plant, 1, ["x"]) for plant in kinds]
    batch, single = Stage(Truth.stack(truths), velocity=0.5), [Stage(truth, velocity=0.5) for truth in truths]
    for _ in range(3):
        batch.advance(MS, np.full((len(kinds), 1), 1.0))
        for stage in single:
            stage.advance(MS, [1.0])
    assert batch.position.tolist() == [stage.position.tolist() for stage in single]
    assert batch.velocity.tolist() == [stage.velocity.tolist() for stage in single]
