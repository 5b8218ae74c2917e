"""Batches, sweeps, tuning and comparison: one arithmetic, whoever runs it."""

import shlex
from itertools import pairwise
from pathlib import Path
from shutil import copy
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
import tomlkit

from hil.analysis.stability import check_stability
from hil.control.gain import Knob, knobs
from hil.control.law_registry import law_class
from hil.rig.file import load_rig
from hil.rig.law_names import LAWS
from hil.rig.schema import LawConfig, RigError
from hil.studies.tune.candidate_simulation import CandidateSimulation, Trial
from hil.studies.tune.objective import (
    NO_MARGINS,
    Bench,
    Margins,
    margins_of,
    rounded_to,
    trials,
)
from hil.studies.tune.search import front, search, write_gains
from hil.studies.tune.search_space import knob_scale, space_of
from hil.virtual.batch import BatchRun
from hil.virtual.invariants import Invariants
from hil.virtual.lockstep import LockstepRun
from hil.virtual.sim import simulate
from sim_plant.physics.stage import Truth
from tests.support.paths import RIGS

SHORT = ["rate_hz=200", "task.kind=point_to_point", "task.target=[0.001, 0.001]", "task.move_s=0.5"]
ALL = {law: knobs(law_class(LawConfig(name=law)).GAINS, plan=False) for law in LAWS}
SPACE = {law: found for law, found in ALL.items() if found}  # the laws that declare something to search
FROM_MIDDLE = [law for law, found in SPACE.items() if not any(knob.scale == "own" for knob in found.values())]
STRUCTURED = LawConfig(name="structured-kalman")
PAPER, MICROSCOPE = RIGS / "paper.toml", RIGS / "microscope-ideal.toml"
QUICK = ["task.radius=0.01", "task.approach_s=0.2", "task.settle_s=0.1", "plant.modelling_error=0.1"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("rig_file", "law", "opening_s"),
    [
        (PAPER, "pd-feedforward", 0.0),
        (PAPER, "structured-kalman", 0.0),
        (PAPER, "slotine-li", 0.0),
        (MICROSCOPE, "", 0.0),
        (MICROSCOPE, "", 0.001),
        (MICROSCOPE, "", 0.02),
    ],
)
def test_a_batch_equals_the_full_path_bit_for_bit(rig_file: Path, law: str, opening_s: float) -> None:
    """Protocol, wire, drives and cycle on one side, arrays on the other: the same error and force in every tick."""
    changes = ["wire.stuffing=worst"] + ([f"law.name={law}", "plant.modelling_error=0.3"] if law else [])
    rig = load_rig(rig_file, [*changes, f"drives.brake_opening_s={opening_s}"])
    single = LockstepRun(rig, rig_file.parent, observer=Invariants(rig, rig_file.parent).observe)
    truth = Truth.from_config(rig.plant, len(rig.axes), rig.axis_names)
    batch = BatchRun(rig, Truth.stack([truth, truth]))
    while single.activated_at < 0:
        single.tick()
    for _ in range(rig.opening_ticks):
        single.tick()
    batch.tick()
    for _ in range(700):
        single.tick()
        batch.tick()
        error = single.true_position - [x.sample.position for x in single.cycle.inputs]
        for member in range(2):
            assert np.array_equal(batch.error[member], error)
            assert batch.force[member].tolist() == single.cycle.gate.force


@pytest.mark.parametrize("rig_file", [PAPER, MICROSCOPE])
def test_every_law_can_be_tuned_and_points_turn_back_into_gains(rig_file: Path) -> None:
    rig = load_rig(rig_file)
    for law in SPACE:
        space = space_of(rig, law)
        for axis in range(len(rig.axes)):
            bench = Bench(load_rig(rig_file, [f"law.name={law}"]), law, axis, [Trial("own", {}, 4.0)])
            points = np.random.default_rng(1).random((3, len(space)))
            gains = bench.gains(points)
            for candidate in range(3):
                one = {name: float(values[candidate]) for name, values in gains.items()}
                assert bench.point(one) == pytest.approx(points[candidate], abs=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("law", ["structured-kalman", "slotine-li"])
def test_a_simulation_equals_a_batch_bit_for_bit(law: str) -> None:
    """One axis of many candidates beside other tasks, or both axes of one plant: the same errors."""
    rig = load_rig(PAPER, [*QUICK, f"law.name={law}"])
    truth = Truth.from_config(rig.plant, 2, rig.axis_names)
    batch = BatchRun(rig, Truth.stack([truth]))
    largest = np.zeros(2)
    for tick in range(600):
        batch.tick()
        if tick >= 200:
            largest = np.maximum(largest, np.abs(batch.error[0]))
    for axis in range(2):
        chosen = [Trial("own", {}, 4.0), Trial("other", {"radius": 0.02}, 4.0), Trial("late", {}, 4.0, jitter=5e-5)]
        simulation = CandidateSimulation(rig, axis, chosen[:2], 200, 600, 1)
        known = rig.law.effective_gains()
        gains = {key: np.full(2, float(np.broadcast_to(value, (2,))[axis])) for key, value in known.items()}
        gains = gains or {"rate": np.full(2, 0.15 / 1e-3)}
        figures = simulation.run(rig.law, gains)
        assert np.all(figures.largest[:, 0] == largest[axis])
        assert np.all(figures.largest[:, 1] != largest[axis])
        late = CandidateSimulation(rig, axis, chosen, 200, 600, 1).run(rig.law, gains)
        assert np.all(late.largest[:, :2] == figures.largest)
        assert np.all(late.largest[:, 2] != figures.largest[:, 0])


@pytest.mark.slow
def test_late_and_lost_commands_in_a_simulation_are_those_of_the_wire() -> None:
    """Not the same numbers, as the wire draws its own, but the same size: what is tuned for is what happens."""
    changes = ["law.name=structured-kalman", "task.radius=0.1", "task.approach_s=0.5", "task.settle_s=0.5"]
    rig = load_rig(PAPER, changes)
    trials = [Trial("late", {}, 1.0, jitter=5e-5), Trial("lost", {}, 1.0, loss=0.01)]
    gains = {key: np.array([values[0]]) for key, values in rig.law.effective_gains().items()}
    simulated = CandidateSimulation(rig, 0, trials, 1000, 4000, 1).run(STRUCTURED, gains).rms[0]
    for index, change in enumerate(("wire.jitter=5e-5", "wire.drop_probability=0.005")):
        report, _ = simulate(load_rig(PAPER, [*changes, change]), RIGS, 4.0)
        assert 0.5 < report.axes["x"]["rms_error"] / simulated[index] < 2.0


@pytest.mark.long
@pytest.mark.usefixtures("short_trials")
def test_a_search_lowers_the_cost_and_never_loses_its_start() -> None:
    rig = load_rig(PAPER, ["task.radius=0.01", "task.frequency_hz=4", "task.approach_s=0.2", "law.gains.kp=300"])
    bench = Bench(rig, "pd-feedforward", 1, [Trial("own", {}, 4.0), Trial("light", {}, 4.0, 0.8, 1.3)])
    before = bench.run(bench.known()[None]).cost[0]
    best, met = search(bench, 8, 3, 1, lambda outcome: None)
    after = bench.run(best[None]).cost[0]
    assert after < before
    trade = front(met[:, :2])
    assert all(one[0] < two[0] and one[1] > two[1] for one, two in pairwise(trade))
    again, _ = search(bench, 8, 3, 1, lambda outcome: None)
    assert np.array_equal(again, best)
    assert rounded_to(4, 12345.6) == 12350.0


def test_what_a_law_raises_in_a_trial_is_told_in_its_own_words() -> None:
    bench = SimpleNamespace(axis=0, space=("kp",), known=lambda: np.array([0.5]))
    bench.run = Mock(side_effect=ValueError("law ./own.py:Own: ./own.py:9: force returned None, expected a number"))
    with pytest.raises(ValueError, match=r"own\.py:9: force returned None"):
        search(bench, 5, 1, 0, lambda _: None)  # type: ignore[arg-type]  # no more of a bench is asked


def test_figures_are_tuned_on_many_tasks_and_plans_on_themselves() -> None:
    figures = trials(load_rig(PAPER))
    assert {trial.task["kind"] for trial in figures if "kind" in trial.task} == {"lissajous", "point_to_point"}
    assert any(trial.jitter for trial in figures)
    assert any(trial.loss for trial in figures)
    plans = trials(load_rig(MICROSCOPE))
    assert all(trial.rms and set(trial.task) == {"injection"} for trial in plans)
    assert {trial.task["injection"].approach_s for trial in plans} == {1.6, 2.0, 2.4}
    assert {(0.8, 0.7), (1.2, 1.3)} < {(trial.mass, trial.friction) for trial in plans}
    near, far = (
        {trial.good for trial in plans if (abs(trial.mass - 1.0) > 0.1) == off_the_nominal_resolution}
        for off_the_nominal_resolution in (False, True)
    )
    assert max(near) < min(far)  # a plant like the rig's own weighs more


SMALL_PLAN = ["cells=1", "approach_s=0.3", "transfer_s=0.2", "withdraw_s=0.2", "dwell_s=0.1"]


@pytest.mark.slow
def test_a_plan_is_judged_from_the_focal_range_until_it_ends_as_hil_sim_does() -> None:
    """Each trial over a window of its own, whatever runs beside it."""
    rig = load_rig(MICROSCOPE, ["wire.stuffing=worst", *(f"task.injection.{change}" for change in SMALL_PLAN)])
    assert rig.task.injection is not None
    longer = rig.task.injection.model_copy(update={"dwell_s": 0.3})
    report, _ = simulate(rig, RIGS, 1.37)
    pair = [Trial("longer", {"injection": longer}, 4.0, rms=True), Trial("own", {}, 4.0, rms=True)]
    for axis in (0, 2):
        gains = {key: np.array([values[axis]]) for key, values in rig.law.effective_gains().items()}
        beside, alone = (
            CandidateSimulation(rig, axis, chosen, None, None, 1).run(STRUCTURED, gains) for chosen in (pair, pair[1:])
        )
        figures = report.axes[rig.axis_names[axis]]
        assert beside.largest[0, 1] == alone.largest[0, 0] == figures["max_error"]
        assert beside.rms[0, 1] == alone.rms[0, 0] == pytest.approx(figures["rms_error"], rel=0.01)


def test_repeats_are_the_same_trials_a_little_smaller() -> None:
    """The largest error of a few seconds is partly luck; a gain that holds it in many sizes holds it."""
    rig = load_rig(PAPER)
    once, thrice = trials(rig), trials(rig, 3)
    assert thrice[: len(once)] == once
    assert len({trial.name for trial in thrice}) == 3 * len(once)
    for trial, smaller in zip(once, thrice[2 * len(once) :], strict=True):
        assert smaller.good == trial.good
        if "radius" in trial.task:
            assert smaller.task["radius"] == pytest.approx(0.9 * trial.task["radius"])
        else:
            assert smaller.task["target"] == pytest.approx([0.9 * place for place in trial.task["target"]])
    with pytest.raises(RigError, match=r"--repeats 2: task\.kind = 'injection'"):
        trials(load_rig(MICROSCOPE), 2)


def test_late_trials_of_one_jitter_move_together_and_as_they_would_alone() -> None:
    rig = load_rig(PAPER, [*QUICK, "law.name=structured-kalman"])
    chosen = [Trial("late", {}, 4.0, jitter=5e-5), Trial("on time", {}, 4.0), Trial("heavy", {}, 4.0, 1.2, jitter=5e-5)]
    gains = {key: np.array([values[0]]) for key, values in rig.law.effective_gains().items()}
    together = CandidateSimulation(rig, 0, chosen, 200, 500, 1)
    assert np.array_equal(together.schedule.delay[:, 0], together.schedule.delay[:, 2])
    assert together.schedule.delay[:, 0].max() > 9e4
    assert not together.schedule.delay[:, 1].any()
    alike = CandidateSimulation(rig, 0, [chosen[0], chosen[1], chosen[0]], 200, 500, 1).run(STRUCTURED, gains)
    figures = together.run(STRUCTURED, gains)
    assert alike.largest[0, 0] == alike.largest[0, 2] == figures.largest[0, 0]
    assert figures.largest[0, 2] != figures.largest[0, 0]


def test_found_gains_go_into_the_rig_file_and_nothing_else_changes(tmp_path: Path) -> None:
    target = tmp_path / "rig.toml"
    copy(PAPER, target)
    write_gains(target, "magic", {"kp": [1.0, 2.0], "kd": [0.5, 0.25]}, ["found by a test"])
    text = target.read_text()
    assert "# found by a test" in text
    for line in PAPER.read_text().splitlines():
        assert line in text
    changed = load_rig(target)
    assert changed.law.tuned["magic"] == {"kp": [1.0, 2.0], "kd": [0.5, 0.25]}
    assert changed.plant == load_rig(PAPER).plant
    assert tomlkit.parse(text)["law"]["tuned"]["structured-kalman"]


def test_found_gains_are_not_hidden_by_gains_that_were_there_before(tmp_path: Path) -> None:
    """[law.gains] overrides what was tuned for the law that the file names."""
    target = tmp_path / "rig.toml"
    document = tomlkit.parse(PAPER.read_text())
    document["law"] = {"name": "robust-pd", "gains": {"kp": 7.0, "beta": 50.0}}
    target.write_text(tomlkit.dumps(document))
    write_gains(target, "robust-pd", {"kp": [1.0, 2.0], "kd": [0.5, 0.25]}, [])
    assert load_rig(target).law.effective_gains() == {"kp": [1.0, 2.0], "kd": [0.5, 0.25], "beta": 50.0}
    write_gains(target, "pid", {"beta": [1.0, 2.0]}, [])
    assert load_rig(target).law.gains == {"beta": 50.0}


def test_found_gains_take_out_what_was_learnt_with_others(tmp_path: Path) -> None:
    target = tmp_path / "rig.toml"
    target.write_text('[law]\nname = "presliding-kalman"\nlearnt = "rig.learnt.json"\n')
    write_gains(target, "pid", {"beta": [1.0]}, [])
    assert tomlkit.parse(target.read_text())["law"]["learnt"] == "rig.learnt.json", (
        "which serves the law it was learnt by"
    )
    write_gains(target, "presliding-kalman", {"integral": [0.05]}, [])
    assert "learnt" not in tomlkit.parse(target.read_text())["law"]


@pytest.mark.usefixtures("short_trials")
def test_a_candidate_pays_for_margins_it_lacks() -> None:
    rig = load_rig(PAPER, ["law.name=pd-feedforward", *SHORT])
    price = [
        Bench(rig, "pd-feedforward", 0, [Trial("own", {}, 4.0)], Margins(gain_db, phase)).run(np.full((2, 2), 0.5)).cost
        for gain_db, phase in ((0.0, 0.0), (40.0, 0.0), (0.0, 90.0))
    ]
    assert price[0][0] == price[0][1]
    assert np.all(price[1] > price[0])
    assert np.all(price[2] > price[0])
    assert Margins(7.0, 35.0).short(Margins(6.0, 30.0)) == 0.0
    assert NO_MARGINS.short(Margins(0.0, 0.0)) == 20.0


def test_margins_of_candidates_are_those_of_hil_check() -> None:
    """One axis of the rig, copied for every candidate, or the rig as it is: the same loop."""
    rig = load_rig(PAPER, ["law.name=structured-kalman"])
    report = check_stability(rig)
    for index, axis in enumerate(report.axes.values()):
        bench = Bench(rig, "structured-kalman", index, [Trial("own", {}, 4.0)])
        gains = {key: np.array([values[index]] * 2) for key, values in rig.law.effective_gains().items()}
        expected = margins_of(axis)
        assert expected.gain_db > 3.0
        for found in bench.margins(gains):
            assert found == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("law", FROM_MIDDLE)
def test_gains_of_the_rig_are_whole_and_say_how_they_were_found(law: str) -> None:
    """Every knob of every law from one command from mid-range. Their margins: tests/analysis/test_stability.py."""
    assert set(load_rig(PAPER).law.tuned[law]) == set(SPACE[law])
    section = PAPER.read_text().split(f"[law.tuned.{law}]", 1)[1]
    command = section.splitlines()[1]
    assert command.startswith(f"# hil tune deploy/rigs/paper.toml --law {law} ")
    assert command.count("--start middle") == 1
    assert "--only" not in command


@pytest.mark.parametrize("law", ["structured-kalman", "pd-feedforward"])
def test_gains_of_the_microscope_come_from_the_search_that_is_written_above_them(law: str) -> None:
    """From mid-range over every knob, and every gain lies within what is searched."""
    rig = load_rig(MICROSCOPE)
    command = shlex.split(MICROSCOPE.read_text().split(f"[law.tuned.{law}]\n", 1)[1].splitlines()[0])
    assert command[:6] == ["#", "hil", "tune", "deploy/rigs/microscope-ideal.toml", "--law", law]
    assert command[-2:] == ["--start", "middle"]
    gains = rig.law.tuned[law]
    assert set(space_of(rig, law)) <= set(gains)
    for axis in range(len(rig.axes)):
        bench = Bench(load_rig(MICROSCOPE, [f"law.name={law}"]), law, axis, [Trial("own", {}, 4.0)])
        for name, values in bench.gains(bench.known()[None]).items():
            assert values[0] == pytest.approx(gains[name][axis], rel=1e-3), name


def test_knob_scales_follow_mass_rate_friction_and_encoder() -> None:
    from hil.control.nominal_model import rig_model

    model = rig_model(load_rig(PAPER))
    knob = SPACE["pd-feedforward"]["kp"]
    slow, fast = (knob_scale(knob, model, period, np.ones(2), 1e-7) for period in (2e-3, 1e-3))
    assert fast == pytest.approx(4 * slow)
    friction = knob_scale(Knob(0.1, 1.0, "C"), model, 1e-3, np.ones(2), 1e-7)
    assert friction.tolist() == [1.146, 0.172]
    noise = SPACE["structured-kalman"]["measurement_noise"]
    assert knob_scale(noise, model, 1e-3, np.ones(2), 1e-7) * noise.low == pytest.approx(1e-7 / 12**0.5, rel=0.01)


def test_the_filters_parameters_are_learnt_at_a_rate_in_samples() -> None:
    """Their noises follow the acceleration's: what a parameter is credited with per period stays as it was."""
    rig = load_rig(PAPER)
    whole = Bench(rig, "structured-kalman", 0, [Trial("own", {}, 4.0)])
    points = np.full((2, len(whole.space)), 0.5)
    points[1, list(whole.space).index("acceleration_noise")] = 0.7
    found = whole.gains(points)
    factor = found["acceleration_noise"][1] / found["acceleration_noise"][0]
    assert factor > 2.0
    for name, knob in whole.space.items():
        if knob.of:
            assert found[name][1] == pytest.approx(factor * found[name][0])
    # Of a knob that is not turned it is the rig file's value.
    some = Bench(rig, "structured-kalman", 0, [Trial("own", {}, 4.0)], only=["coulomb_noise"])
    known = rig.law.tuned["structured-kalman"]
    assert some.gains(some.known())["coulomb_noise"] == pytest.approx(known["coulomb_noise"][0])


@pytest.mark.long
def test_the_middle_of_the_ranges_is_a_sensible_law(monkeypatch: pytest.MonkeyPatch) -> None:
    """Axes of different mass and friction: where a search begins, the law is already ten times better than a PD."""
    monkeypatch.setattr("hil.studies.tune.objective.SETTLE_S", 1.5)
    monkeypatch.setattr("hil.studies.tune.objective.WINDOW_S", 1.0)
    own = Trial("own", {"approach_s": 0.5}, 4.0, error=0.06)
    for axis, error in enumerate((20e-6, 1e-6)):
        bench = Bench(load_rig(PAPER), "structured-kalman", axis, [own, own._replace(mass=0.8, friction=1.3)])
        outcome = bench.run(np.full((1, len(bench.space)), 0.5))
        assert outcome.error < error
        assert outcome.gain_db > 6.0
        assert outcome.phase_deg > 30.0
