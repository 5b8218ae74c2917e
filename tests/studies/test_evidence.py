"""Evidence over drawn stages: the draws, the figures, and a short slice of what `presliding-kalman` holds."""

from dataclasses import fields

import numpy as np
import pytest

from hil.control.trajectories.chosen_axes import ChosenAxes
from hil.control.trajectories.segments import Segments, rest
from hil.rig.file import load_rig
from hil.rig.schema import DrivesConfig, RigConfig
from hil.studies.evidence.rows import pooled, quantile_interval
from hil.studies.evidence.stages import PRESLIDING, TOLD, columns, nominal, only, overrides, plant_of, stage_of
from hil.studies.evidence.trials import (
    LONG,
    MOVE,
    PLAN,
    STEP_S,
    TRIALS,
    Job,
    Trial,
    _at_rest,
    _errors,
    jobs,
    run,
    trajectory_of,
)
from sim_plant.physics.truth import Truth
from tests.support.paths import RIGS

MILLISECOND = 1_000_000  # ns


def rig(law: str = "presliding-kalman") -> RigConfig:
    return load_rig(RIGS / "microscope-ideal.toml", [f"law.name={law}"])


def job(trial: Trial, *, axes: tuple[str, ...] = ("x",), law: str = "presliding-kalman", mode_hz: float = 0.0) -> Job:
    return Job(rig(law).model_dump_json(), axes, 7, 2, trial, mode_hz)


def test_a_stage_follows_from_seed_and_number_alone_and_keeps_to_the_distributions() -> None:
    one = rig()
    again = stage_of(one, 3, 5, 150.0)
    drawn = [stage_of(one, 3, number, 150.0) for number in range(40)]
    assert np.array_equal(drawn[5].mass, again.mass)
    assert not np.array_equal(drawn[5].mass, stage_of(one, 4, 5, 150.0).mass)
    presliding = np.array([truth.presliding for truth in drawn])
    assert PRESLIDING[0] <= presliding.min() < 1e-6
    assert 1e-5 < presliding.max() <= PRESLIDING[1]
    friction = np.array([truth.coulomb for truth in drawn]) / [axis.model.coulomb for axis in one.axes.values()]
    assert 0.7 <= friction.min() < 0.8
    assert 1.2 < friction.max() <= 1.3
    assert (columns(again, [2]).cogging["phase"] == again.cogging["phase"][2]).all()


def test_a_hard_stage_is_the_same_stage_with_more_of_what_real_ones_have() -> None:
    one = rig()
    plain, hard = plant_of(one, 3, 5, 150.0), plant_of(one, 3, 5, 150.0, hard=True)
    differs = {name for name, value in hard if value != getattr(plain, name)}
    assert differs == {
        "friction_period", "stribeck_scale", "stribeck_velocity", "encoder_periodic_error", "encoder_latency",
        "modes", "slip",
    }  # fmt: skip
    assert [mode for mode in hard.modes if mode.tool] == plain.modes
    drawn = [plant_of(one, 3, number, 0.0, hard=True) for number in range(30)]
    periods = np.array([plant.friction_period for plant in drawn])
    assert 0.6e-3 <= periods.min() < 0.7e-3
    assert 1.9e-3 < periods.max() <= 2e-3
    assert all(Truth.from_config(plant, 4, one.axis_names) for plant in drawn)


@pytest.mark.parametrize("mode_hz", [0.0, 150.0, 250.0])
def test_hard_stages_ring_where_no_model_says_and_half_of_them_slip_element_by_element(mode_hz: float) -> None:
    one = rig()
    drawn = [plant_of(one, 3, number, mode_hz, hard=True) for number in range(60)]
    others = [[m for m in plant.modes if m.axis == "x" and not m.tool] for plant in drawn]
    assert 20 <= sum(len(found) == 2 for found in others) <= 40
    assert all(found for found in others)
    first = [max([0.0, *(m.frequency_hz for m in plant.modes if m.axis == "x" and m.tool)]) for plant in drawn]
    low = np.array([1.5 * hertz / 0.7**0.5 or 150.0 for hertz in first])
    part = (np.array([found[0].frequency_hz for found in others]) - low) / (450.0 - low)
    assert 0.0 <= part.min() < 0.1
    assert 0.9 < part.max() <= 1.0
    loads, ratios = (np.array([getattr(found[-1], key) for found in others]) for key in ("load", "damping"))
    assert 0.02 <= loads.min() < 0.025
    assert 0.075 < loads.max() <= 0.08
    assert 0.005 <= ratios.min() < ratios.max() <= 0.02
    truths = [stage_of(one, 3, number, mode_hz, hard=True) for number in range(60)]
    slipping = [truth.slip[0] for truth in truths if truth.slip["limit"][0].any()]
    assert 20 <= len(slipping) <= 40
    lengths = np.array([slip["limit"] / slip["stiffness"] for slip in slipping])
    spread = lengths[:, -1] / lengths[:, 0]
    assert spread.min() * (1 + 1e-9) >= 5.0
    assert 40.0 < spread.max() <= 50.0 * (1 + 1e-9)


def test_where_the_first_resonance_leaves_no_room_below_half_the_rate_a_hard_stage_has_no_other() -> None:
    assert all(mode.tool for mode in plant_of(rig(), 3, 5, 400.0, hard=True).modes)
    heavy = load_rig(
        RIGS / "microscope-ideal.toml", ["axes.x.model.mode_frequency_hz=60", "axes.x.model.mode_load=0.9"]
    )
    for number in range(10):
        loads = [mode.load for mode in plant_of(heavy, 3, number, None, hard=True).modes if mode.axis == "x"]
        assert len(loads) > 1
        assert sum(loads) <= 0.95


def stated(others: list[list[float]]) -> RigConfig:
    """The rig whose X says that it has these resonances beside the first."""
    return load_rig(RIGS / "microscope.toml", ["law.name=presliding-kalman", f"axes.x.model.other_modes={others}"])


def test_a_stage_has_the_resonances_that_its_model_states_within_their_tolerance() -> None:
    told = stated([[260.0, 0.01, 0.05], [380.0, 0.02, 0.06]])
    drawn = [plant_of(told, 3, number, 150.0) for number in range(60)]
    found = [[mode for mode in plant.modes if not mode.tool] for plant in drawn]
    assert {(mode.axis, mode.damping, mode.load) for pair in found for mode in pair} == {
        ("x", 0.01, 0.05), ("x", 0.02, 0.06),
    }  # fmt: skip
    shares = np.array([[mode.frequency_hz for mode in pair] for pair in found]) / (260.0, 380.0)
    assert 0.9 <= shares.min() < 0.92
    assert 1.08 < shares.max() <= 1.1
    assert abs(np.corrcoef(shares.T)[0, 1]) < 0.5  # each is off by itself
    one = drawn[5]
    assert one.model_copy(update={"modes": [mode for mode in one.modes if mode.tool]}) == plant_of(
        stated([]), 3, 5, 150.0
    )


def test_a_hard_stage_has_others_that_no_model_states_as_far_as_an_axis_can() -> None:
    whole = stated([[380.0, 0.02, 0.06]])
    counts = set()
    for number in range(20):
        known = [mode for mode in plant_of(whole, 3, number, 0.0).modes if mode.axis == "x"]
        modes = [mode for mode in plant_of(whole, 3, number, 0.0, hard=True).modes if mode.axis == "x"]
        assert modes[:1] == known
        counts.add(len(modes))
    assert counts == {2}
    full = stated([[260.0, 0.01, 0.05], [380.0, 0.02, 0.06]])
    assert sum(mode.axis == "x" for mode in plant_of(full, 3, 5, 0.0, hard=True).modes) == 2


@pytest.mark.long
def test_a_stage_that_rings_where_nothing_is_stated_is_held_where_it_is() -> None:
    """10 mm at 1 Hz on rigid stages with a resonance of 280 Hz that carries 6 % of the mass."""
    whole = nominal(stated([[280.0, 0.006, 0.06]]), 0.0)
    told, silent = only(whole, ["x"]), only(nominal(stated([]), 0.0), ["x"])
    trial = Trial(LONG, 2.0, 1.0, False)
    stages = Truth.stack([columns(stage_of(whole, 3, number, 0.0), [0]) for number in range(3)])
    trajectory = ChosenAxes(trajectory_of(whole, trial), [0])
    with_it, without = (np.abs(_errors(one, stages, trajectory, 2000, False)) for one in (told, silent))
    assert with_it[1000:].max() < 8e-6
    assert without[1000:].max() > 50e-6


def test_stages_of_a_measured_rig_stay_within_what_was_measured() -> None:
    model = rig().axes["x"].model
    own = {"mass": model.mass, "mode_frequency_hz": 120.0, "torque_lag": 3e-4, "viscous": model.viscous}
    sets = [f"axes.x.model.{key}={value}" for key, value in own.items()]
    widths = {"mass": 0.05, "mode_frequency_hz": 0.03, "torque_lag": 0.06, "viscous": 0.2}
    sets += [f"axes.x.measured.{key}=[{own[key]}, {own[key] * share}]" for key, share in widths.items()]
    known = load_rig(RIGS / "microscope-ideal.toml", [*sets, "axes.x.model.presliding=[2e-6,3e-6]"])
    drawn = [plant_of(known, 3, number, None) for number in range(40)]

    def spread(values: list[float], about: float) -> float:
        return float(np.abs(np.array(values) / about - 1.0).max())

    assert 0.03 < spread([plant.mass[0] for plant in drawn], model.mass) <= 0.05
    assert 0.15 < spread([plant.mass[1] for plant in drawn], known.axes["y"].model.mass) <= 0.2
    assert 0.02 < spread([plant.modes[0].frequency_hz for plant in drawn], 120.0) <= 0.03
    assert [entry.axis for entry in drawn[0].modes] == ["x"]
    lengths, lags = [np.array([getattr(plant, key) for plant in drawn])[:, 0] for key in ("presliding", "torque_lag")]
    assert 2e-6 <= lengths.min() < lengths.max() <= 3e-6
    assert spread(lags.tolist(), 3e-4) <= 0.06


@pytest.mark.parametrize("hard", [False, True])
@pytest.mark.parametrize("mode_hz", [0.0, 150.0])
def test_a_stage_of_the_table_can_be_made_of_the_rig_file(mode_hz: float, hard: bool) -> None:
    """What --json writes beside each stage: that rig file is this stage, with what its law is told."""
    one = rig()
    made = load_rig(RIGS / "microscope.toml", ["law.name=presliding-kalman", *overrides(one, 3, 5, mode_hz, hard=hard)])
    of_file, of_table = Truth.from_config(made.plant, 4, made.axis_names), stage_of(one, 3, 5, mode_hz, hard=hard)
    for field in fields(Truth):
        assert np.array_equal(getattr(of_file, field.name), getattr(of_table, field.name)), field.name
    for name, axis in nominal(one, mode_hz).axes.items():
        assert [getattr(made.axes[name].model, key) for key in TOLD] == [getattr(axis.model, key) for key in TOLD]
    assert made.plant.encoder_resolution == one.plant.encoder_resolution


def test_a_row_has_every_stage_of_every_seed_and_says_which_is_the_worst() -> None:
    work = [job(TRIALS[0])._replace(seed=seed, stages=3) for seed in (7, 8)]
    first = {"failed": np.zeros((3, 1), dtype=bool), "RMS": np.array([[3e-9], [1e-9], [4e-9]])}
    second = {"failed": np.array([[False], [True], [False]]), "RMS": np.array([[5e-9], [1e-9], [2e-9]])}
    (row,) = pooled(["x"], work, [first, second])
    assert row["axes"]["x"] == {
        "median": 4e-9, "median_interval": (1e-9, np.inf), "p95": np.inf, "p95_interval": (4e-9, np.inf), "failed": 1,
        "worst": (8, 1), "each": [3e-9, 1e-9, 4e-9, 5e-9, np.inf, 2e-9],
    }  # fmt: skip


@pytest.mark.parametrize(("share", "true"), [(0.5, np.log(2.0)), (0.95, np.log(20.0))])
def test_an_interval_holds_the_true_quantile_as_often_as_it_says(share: float, true: float) -> None:
    rng = np.random.default_rng(41)
    ends = [quantile_interval(rng.exponential(size=60), share) for _ in range(2000)]
    assert 0.95 <= np.mean([low <= true <= high for low, high in ends]) < 0.995


@pytest.mark.parametrize("trial", TRIALS, ids=lambda trial: trial.name)
def test_references_begin_at_rest_and_stay_continuous_within_the_limits(trial: Trial) -> None:
    one = rig()
    path = trajectory_of(one, trial)
    times = np.arange(0, round(trial.seconds * 1000)) * MILLISECOND
    for i, axis in enumerate(one.axes.values()):
        q, v, _ = path.sample_axis(i, times)
        assert q[0] == v[0] == 0.0
        assert np.abs(np.diff(q)).max() <= max(axis.limits.speed * 1e-3, 1.1e-6)
        assert axis.limits.position[0] < q.min() <= q.max() < axis.limits.position[1]
    if path.repeat_ns is not None:
        begin = path.repeat_from_ns + 123 * MILLISECOND
        assert path.at(0, begin) == pytest.approx(path.at(0, begin + 3 * path.repeat_ns), abs=1e-15)


def test_trials_are_those_that_the_rig_has() -> None:
    names = {job.trial.name for job in jobs(rig(), ["x"], 2, 1, [0.0, 150.0])}
    paper = load_rig(RIGS / "paper.toml", [])
    assert names - {job.trial.name for job in jobs(paper, ["y"], 2, 1, [0.0])} == {PLAN}
    assert {job.trial.flexible for job in jobs(rig(), ["x"], 2, 1, [150.0])} == {True}


def test_figures_at_rest_are_what_the_errors_say() -> None:
    """Two stages: one without error; one that holds 2 nm off and takes 30 ms to every step and 20 to the bias."""
    period, seconds = 1e-3, TRIALS[-1].seconds
    error = np.zeros((round(seconds / period), 2, 1))
    error[:, 1] = 2e-9
    for begin in (15.0, 15.0 + STEP_S, 15.0 + 2 * STEP_S, 15.0 + 3 * STEP_S):
        at = round(begin / period)
        error[at : at + 30, 1] = 51e-9
    at = round((15.0 + 4 * STEP_S + 0.5) / period)
    error[at : at + 20, 1] = 3e-7
    found = {name: values[:, 0].tolist() for name, values in _at_rest(error, period).items()}
    assert found == {
        "hold 10 s, RMS": [0.0, pytest.approx(2e-9)],
        "1 um step to 50 nm": [0.0, pytest.approx(0.03)],
        "step of the bias, peak": [0.0, 3e-7],
        "step of the bias, back to 100 nm": [0.0, pytest.approx(0.02)],
    }


def test_some_of_the_axes_are_tried_with_their_own_gains() -> None:
    whole = load_rig(RIGS / "microscope-ideal.toml", ["law.gains.integral=[0.1, 0.2, 0.3, 0.4]"])
    some = only(whole, ["y", "z"])
    assert list(some.axes) == ["y", "z"]
    assert some.law.gains == {"integral": [0.2, 0.3]}
    assert some.law.tuned["pd-feedforward"]["kp"] == whole.law.tuned["pd-feedforward"]["kp"][1:3]
    assert some.estimator.disturbance_noise == [1.0, 0.5]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("trial", "mode_hz", "peak", "rms"),
    [(Trial(MOVE, 3.0, 2.0, False), 0.0, 1.0e-6, 120e-9), (Trial(LONG, 3.0, 2.0, True), 150.0, 2.5e-6, 600e-9)],
    ids=["rigid", "tool on a spring"],
)
def test_presliding_kalman_on_drawn_stages(trial: Trial, mode_hz: float, peak: float, rms: float) -> None:
    found = run(job(trial, mode_hz=mode_hz))
    assert not found["failed"].any()
    assert found["peak"].max() < peak
    assert found["RMS"].max() < rms


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode_hz", "seed", "numbers"),
    [(0.0, 2026, (0, 3, 6, 10, 15)), (150.0, 7, (2, 11, 14, 15))],
    ids=["rigid", "tool on a spring"],
)
def test_a_weight_that_its_brake_lets_go_comes_to_rest_after_moves(
    mode_hz: float, seed: int, numbers: tuple[int, ...]
) -> None:
    """Some of these rang by up to 2 um: their weights took the throw of the opening brake for friction."""
    whole = nominal(load_rig(RIGS / "microscope.toml", ["drives.brake_opening_s=0"]), mode_hz)
    truth = Truth.stack([columns(stage_of(whole, seed, number, mode_hz), [2]) for number in numbers])
    path = ChosenAxes(trajectory_of(whole, TRIALS[-1]), [2])
    error = _errors(only(whole, ["z"]), truth, path, 4700, False)
    assert 1e-6 < np.abs(error[:200]).max() < (12e-6 if mode_hz else 6e-6)
    assert np.sqrt(np.mean(error[-500:] ** 2, axis=0)).max() < 10e-9


def test_a_brake_that_opens_on_the_weight_s_force_throws_nothing() -> None:
    """The bias of the stages alone, a tenth of the friction at most, is not known before."""
    whole = nominal(load_rig(RIGS / "microscope.toml"), 0.0)
    truth = Truth.stack([columns(stage_of(whole, 2026, number, 0.0), [2]) for number in range(6)])
    held = Segments([rest(0, [0.0] * len(whole.axes))], repeat=False, phase_names=("hold",))
    thrown, kept = (
        np.abs(_errors(only(rig, ["z"]), truth, ChosenAxes(held, [2]), 100, False)).max(axis=0)
        for rig in (whole.model_copy(update={"drives": DrivesConfig(brake=whole.drives.brake)}), whole)
    )
    assert thrown.min() > 1e-6
    assert (kept < 0.4 * thrown).all(), (kept, thrown)


def test_the_rig_is_told_what_lag_and_mode_are_on_average() -> None:
    model = nominal(rig(), 150.0).axes["x"].model
    assert (model.torque_lag, model.mode_load) == (2e-4, 0.3)
    assert model.mode_frequency_hz == pytest.approx(150.0 * 0.7**0.5)
