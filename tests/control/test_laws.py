"""Every control law: feedforward alone at rest, bounded, symmetric, and a batch is its members one by one."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from hil.control.laws import make_axis_laws, make_law
from hil.control.laws.base import Array, Law, LawInputs, Model, Reference
from hil.control.nominal_model import blank_inputs
from hil.rig.file import load_rig
from hil.rig.law_names import LAWS
from hil.rig.schema import LawConfig
from hil.studies.population import CORNERS
from hil.studies.tune.candidate_simulation import CandidateSimulation, Trial
from tests.support.paths import RIGS

PERIOD = 1e-3
LIMIT = np.array([5.0, 5.0])
GRAVITY = np.array([0.0, 0.7])
TUNED = load_rig(RIGS / "paper.toml").law.tuned
WITH_TUNED = ", gains of paper.toml"
FROM_REST = "structured-kalman, from rest"
# A lag beyond most of the scene's errors: the axis seems to stand for a while after the reference has left.
FROM_REST_GAINS = {"stribeck_velocity": [0.3, 0.0], "breakaway_rate": [20.0, 5.0], "breakaway_lag": 2e-4}
NAMES = [*LAWS, "learning", FROM_REST, *(name + WITH_TUNED for name in TUNED)]


def model(gravity: Array = GRAVITY) -> Model:
    return Model(
        mass=np.array([0.022180, 0.011386]),
        coulomb=np.array([1.146, 0.172]),
        viscous=np.array([-0.04749, 0.04023]),
        quadratic=np.array([0.00265, -0.001473]),
        gravity=gravity,
    )


def configured(name: str, **gains: Any) -> LawConfig:
    if name == "learning":
        return LawConfig(gains=gains, iterative_learning=True)
    if name == FROM_REST:
        return LawConfig(name="structured-kalman", gains={**FROM_REST_GAINS, **gains})
    own = name.removesuffix(WITH_TUNED)
    return LawConfig(name=own, gains={**(TUNED[own] if name != own else {}), **gains})


def law(name: str, gravity: Array = GRAVITY, **gains: Any) -> Law:
    return make_law(configured(name, **gains), model(gravity), PERIOD, LIMIT, repeat=(50_000_000, 0))


class Scene:
    """A moving reference, measured errors and fed-back forces, the same for every law; `sign` mirrors all of it."""

    def __init__(self, ticks: int, batch: tuple[int, ...] = (), sign: float = 1.0, seed: int = 1) -> None:
        random = np.random.default_rng(seed)
        self.sign = sign
        self.errors = 1e-4 * random.standard_normal((ticks, *batch, 2))
        self.times = np.arange(ticks + 2)[:, None] * PERIOD * np.array([1.0, 0.9])
        self.batch = batch

    def reference(self, k: int) -> Reference:
        t = 40.0 * self.times[k]
        return Reference(
            self.sign * 1e-2 * np.cos(t), self.sign * -0.4 * np.sin(t), self.sign * -16.0 * np.cos(t)
        )  # fmt: skip

    def inputs(self, k: int, forces: tuple[Array, Array]) -> LawInputs:
        inputs = blank_inputs((*self.batch, 2))
        inputs.sample, inputs.start, inputs.end = (self.reference(max(k + shift, 0)) for shift in (-1, 0, 1))
        error = self.sign * self.errors[k]
        inputs.position = inputs.sample.position + error
        inputs.fresh = np.ones(2)
        inputs.sample_interval = inputs.ahead = np.full(2, PERIOD)
        inputs.position_estimate = inputs.start.position + 0.9 * error
        inputs.velocity_estimate = inputs.start.velocity + 50.0 * error
        inputs.mean_velocity = 0.5 * (inputs.start.velocity + inputs.end.velocity)
        inputs.mean_acceleration = (inputs.end.velocity - inputs.start.velocity) / PERIOD
        inputs.mean_sign = np.sign(inputs.mean_velocity)
        inputs.force_last, inputs.force_before = forces
        inputs.task_ns = k * 1_000_000
        return inputs


def play(controller: Law, scene: Scene, member: int | None = None) -> Array:
    """Forces asked for over the scene; member: of a batch scene, alone."""
    if member is not None:
        single = Scene(0, (), scene.sign)
        single.errors, single.times = scene.errors[:, member], scene.times
        scene = single
    shape = (*scene.batch, 2)
    start = np.zeros(shape) + scene.reference(0).position
    controller.reset(start, np.zeros(shape) + controller_gravity(controller))
    forces = (np.zeros(shape), np.zeros(shape))
    asked = []
    for k in range(len(scene.errors)):
        out = controller.force(scene.inputs(k, forces)).copy()
        asked.append(out)
        forces = (np.clip(out, -LIMIT, LIMIT), forces[0])
    return np.array(asked)


def controller_gravity(controller: Law) -> Array:
    return np.zeros(2) if getattr(controller, "no_gravity", False) else GRAVITY


def test_every_law_has_tuned_gains_in_the_papers_rig() -> None:
    assert set(TUNED) == set(LAWS), "hil tune deploy/rigs/paper.toml --law NAME writes a new law's gains"


@pytest.mark.parametrize("name", NAMES)
def test_at_rest_without_error_a_law_asks_for_feedforward_alone(name: str) -> None:
    controller = law(name)
    position = np.array([0.3, -0.2])
    controller.reset(position, GRAVITY)
    for _ in range(200):
        inputs = blank_inputs((2,))
        still = Reference(position.copy(), np.zeros(2), np.zeros(2))
        inputs.sample = inputs.start = inputs.end = still
        inputs.position = inputs.position_estimate = position.copy()
        inputs.fresh[:] = 1.0
        inputs.sample_interval[:] = inputs.ahead[:] = PERIOD
        inputs.force_last[:] = inputs.force_before[:] = GRAVITY
        inputs.task_ns = -1
        assert controller.force(inputs) == pytest.approx(GRAVITY, abs=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("seconds", [2, pytest.param(20, marks=[pytest.mark.slow])])
@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if WITH_TUNED in n else []) for n in NAMES])
def test_a_law_stays_bounded_however_long_the_error_lasts(name: str, seconds: int) -> None:
    """Anti-windup: an error that cannot be removed must not pile up force that takes as long to go away."""
    controller = law(name)
    controller.reset(np.zeros(2), GRAVITY)
    scene = Scene(1)
    asked = np.zeros(2)
    for k in range(1000 * seconds):
        inputs = scene.inputs(0, (LIMIT * np.sign(asked), LIMIT * np.sign(asked)))
        inputs.position = inputs.sample.position + 0.01
        inputs.position_estimate = inputs.start.position + 0.01
        inputs.velocity_estimate = inputs.start.velocity
        inputs.task_ns = k * 1_000_000
        asked = controller.force(inputs).copy()
        assert np.all(np.isfinite(asked))
    assert np.all(np.abs(asked) < 20 * LIMIT + 0.01 * 1e6)
    untouched = law(name)
    untouched.reset(np.zeros(2), GRAVITY)
    for _ in range(300):  # the error is gone: within 0.3 s so is what it left behind
        forces = [each.force(scene.inputs(0, (np.zeros(2), np.zeros(2)))).copy() for each in (controller, untouched)]
    assert np.all(np.abs(forces[0] - forces[1]) < 1.5 * LIMIT)


@pytest.mark.parametrize("name", NAMES)
def test_a_law_is_symmetric_under_sign_change(name: str) -> None:
    zero = np.zeros(2)
    one, other = law(name, zero), law(name, zero)
    one.no_gravity = other.no_gravity = True  # type: ignore[attr-defined]
    assert np.array_equal(play(one, Scene(150)), -play(other, Scene(150, sign=-1.0)))


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_a_batch_is_its_members_one_by_one(name: str) -> None:
    scene = Scene(150, batch=(3,), seed=7)
    together = play(law(name), scene)
    for member in range(3):
        assert np.array_equal(together[:, member], play(law(name), scene, member))


@pytest.mark.parametrize("name", NAMES)
def test_on_plain_floats_axis_by_axis_a_law_asks_for_the_same_bits_as_on_arrays(name: str) -> None:
    ask_for_the_same_bits(name, model())


def test_so_it_does_where_the_friction_of_one_axis_has_a_period() -> None:
    ask_for_the_same_bits("presliding-kalman", dataclasses.replace(model(), friction_period=np.array([0.0, 2e-3])))


def ask_for_the_same_bits(name: str, known: Model) -> None:
    arrays = make_law(configured(name), known, PERIOD, LIMIT, repeat=(50_000_000, 0))
    floats = make_axis_laws(configured(name), known, PERIOD, LIMIT, repeat=(50_000_000, 0))
    scene = Scene(150, seed=11)
    arrays.reset(scene.reference(0).position, GRAVITY)
    floats.reset(scene.reference(0).position.tolist(), GRAVITY.tolist())
    forces = (np.zeros(2), np.zeros(2))
    for k in range(150):
        inputs = scene.inputs(k, forces)
        inputs.answered = float(k % 17 != 0)  # a command is lost now and then
        inputs.fresh = np.full(2, inputs.answered)
        out = arrays.force(inputs).copy()
        assert floats.force([one_axis(inputs, axis) for axis in range(2)]) == out.tolist()
        forces = (np.clip(out, -LIMIT, LIMIT), forces[0])


def one_axis(inputs: LawInputs, axis: int) -> LawInputs:
    """The inputs of one axis, as floats."""

    def pick(value: Any) -> Any:
        if isinstance(value, Reference):
            return Reference(*(float(getattr(value, field.name)[axis]) for field in dataclasses.fields(Reference)))
        return float(value[axis]) if isinstance(value, np.ndarray) else value

    return LawInputs(**{field.name: pick(getattr(inputs, field.name)) for field in dataclasses.fields(LawInputs)})


def test_structured_kalman_shares_one_covariance_but_not_with_missing_samples() -> None:
    scene = Scene(80, batch=(2,), seed=3)
    fresh = np.random.default_rng(4).integers(0, 2, size=(80, 2, 2)).astype(float)
    forces = (np.zeros((2, 2)), np.zeros((2, 2)))
    together, alone = law("structured-kalman"), [law("structured-kalman") for _ in range(2)]
    together.reset(np.zeros((2, 2)), np.zeros((2, 2)) + GRAVITY)
    for one in alone:
        one.reset(np.zeros(2), GRAVITY)
    for k in range(80):
        inputs = scene.inputs(k, forces)
        inputs.fresh = fresh[k]
        inputs.answered = fresh[k].max(axis=-1, keepdims=True)
        out = together.force(inputs)
        for member, one in enumerate(alone):
            single = scene.inputs(k, (np.zeros(2), np.zeros(2)))
            single.position, single.fresh = inputs.position[member].copy(), fresh[k, member]
            single.answered = fresh[k, member].max(keepdims=True)
            assert np.array_equal(one.force(single), out[member])


@pytest.mark.long
def test_structured_kalman_holds_sub_micrometre_error_on_tasks_of_all_sizes() -> None:
    """The rig's gains, 0.3 N of friction it does not know: nominal and in every corner, on and off the sampling grid,
    with late and lost commands, on small figures and moves, where an axis sticks for long before it first moves.
    """
    own = {"approach_s": 1.0}
    move = {"kind": "point_to_point", "target": [0.1, 0.1]}
    chosen = [
        Trial("own", own, 5.0),
        *(Trial("corner", own, 5.0, *corner) for corner in CORNERS.values()),
        Trial("own, RMS", own, 1.0, rms=True),
        *(Trial("corner, RMS", own, 1.0, *corner, rms=True) for corner in CORNERS.values()),
        Trial("off the grid", {**own, "phase": -0.00094}, 30.0),
        Trial("late commands", own, 15.0, jitter=50e-6),
        Trial("lost commands", own, 10.0, loss=0.01),
        Trial("1 mm, 1 Hz", {**own, "radius": 1e-3, "frequency_hz": 1.0}, 10.0),
        Trial("moves", move, 10.0),
    ]
    rig = load_rig(RIGS / "paper.toml", ["law.name=structured-kalman"])
    for axis in range(2):
        trials = [trial._replace(error=0.06) for trial in chosen]
        gains = {key: np.array([values[axis]]) for key, values in rig.law.effective_gains().items()}
        figures = CandidateSimulation(rig, axis, trials, 4000, 5500, 1).run(rig.law, gains)
        for trial, largest, rms in zip(trials, figures.largest[0], figures.rms[0], strict=True):
            assert (rms if trial.rms else largest) < trial.good * 1e-7, trial


def test_robust_pd_floors_its_denominator_and_counts_it() -> None:
    controller: Any = law("robust-pd")
    controller.reset(np.zeros(2), GRAVITY)
    inputs = Scene(1).inputs(0, (np.zeros(2), np.zeros(2)))
    inputs.velocity_estimate = inputs.start.velocity.copy()
    inputs.position_estimate = inputs.start.position + 0.01  # beyond sqrt(epsilon / beta) = 3.2 mm
    assert np.all(np.isfinite(controller.force(inputs)))
    assert controller.denominator_floors == 2


@pytest.mark.parametrize(("reading", "stiffness"), [("printed", 3000.0), ("alpha-brackets", 60 * 3000.0)])
def test_robust_pd_readings_differ_in_static_stiffness(reading: str, stiffness: float) -> None:
    controller = law("robust-pd", np.zeros(2), kp=3000.0, kd=20.0, reading=reading)
    inputs = blank_inputs((2,))
    inputs.position_estimate = np.array([1e-5, 0.0])
    assert controller.force(inputs)[0] == pytest.approx(-stiffness * 1e-5)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (LawConfig(name="magic"), "law.name = 'magic'"),
        (LawConfig(gains={"kq": 1.0}), "law.gains.kq"),
        (LawConfig(gains={"kp": -1.0}), "law.gains.kp = -1.0"),
        (LawConfig(gains={"kp": 10**400}), "law.gains.kp = 1000"),
        (LawConfig(gains={"kp": [1.0]}), "1 values for 2 axes"),
        (LawConfig(name="robust-pd", gains={"reading": "loud"}), "reading = 'loud'"),
    ],
)
def test_bad_gains_are_named(config: LawConfig, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_law(config, model(), PERIOD, LIMIT)


def test_learnt_friction_never_drives_the_axis() -> None:
    """A frictionless axis under a nominal model with friction: what is learnt ends at minus the model's."""
    controller: Any = law("structured-kalman")
    controller.reset(np.zeros(2), GRAVITY)
    scene, force, lowest = Scene(400), np.zeros(2), np.zeros(2)
    for k in range(400):
        inputs = scene.inputs(k, (force, force))
        inputs.position = inputs.sample.position * 1.5  # runs ahead of any force given
        force = np.asarray(controller.force(inputs)).clip(-LIMIT, LIMIT)
        lowest = np.minimum(lowest, controller._disturbance[1])
    assert np.array_equal(lowest, -controller._model.coulomb)
