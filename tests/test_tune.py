"""Batches, sweeps, tuning and comparison: one arithmetic, whoever runs it."""

from itertools import pairwise
from pathlib import Path
from shutil import copy

import numpy as np
import pytest
import tomlkit
from typer.testing import CliRunner

from hil.batch import BatchRun
from hil.cli import build_app
from hil.compare import LEARNING, cases, run_case
from hil.config import RigError, load_rig
from hil.invariants import Invariants
from hil.lockstep import LockstepRun, simulate
from hil.rehearsal import Rehearsal, Trial
from hil.sweep import Job, jobs, plant_rig, processes, reproduce, run_chunk, save_worst
from hil.tune import SPACE, Bench, front, knob_scale, rounded, search, trials, write_gains
from sim_plant.stage import Truth

RIGS = Path(__file__).parent.parent / "deploy" / "rigs"
PAPER = RIGS / "paper.toml"
QUICK = ["task.radius=0.01", "task.approach_s=0.2", "task.settle_s=0.1", "plant.modelling_error=0.1"]


@pytest.mark.parametrize(
    ("rig_file", "law"),
    [(PAPER, "pd-feedforward"), (PAPER, "structured-kalman"), (PAPER, "slotine-li"), (RIGS / "microscope.toml", "")],
)
def test_a_batch_equals_the_full_path_bit_for_bit(rig_file: Path, law: str) -> None:
    """Protocol, wire, drives and cycle on one side, arrays on the other: the same error and force in every tick."""
    changes = ["wire.stuffing=worst"] + ([f"law.name={law}", "plant.modelling_error=0.3"] if law else [])
    rig = load_rig(rig_file, changes)
    single = LockstepRun(rig, rig_file.parent, observer=Invariants(rig, rig_file.parent).observe)
    truth = Truth.from_config(rig.plant, len(rig.axes), rig.axis_names)
    batch = BatchRun(rig, Truth.stack([truth, truth]))
    while single.activated_at < 0:
        single.tick()
    batch.tick()
    for _ in range(700):
        single.tick()
        batch.tick()
        error = single.true_position - [x.sample.position for x in single.cycle.inputs]
        for member in range(2):
            assert np.array_equal(batch.error[member], error)
            assert batch.force[member].tolist() == single.cycle.gate.force


def test_a_sweep_gives_the_same_numbers_however_plants_are_dealt_out() -> None:
    rig = load_rig(PAPER, [*QUICK, "law.name=structured-kalman"])
    document = rig.model_dump_json()
    whole = run_chunk(Job(document, 5, 0, 6, 500, 320, True))
    with processes(2) as crew:
        parts = list(crew.run([Job(document, 5, 0, 4, 500, 320, True), Job(document, 5, 4, 2, 500, 320, True)]))
    for together, first, second in zip(whole, *parts, strict=True):
        assert np.array_equal(together, np.concatenate([first, second]))


def test_the_worst_plants_reproduce_singly_bit_for_bit(tmp_path: Path) -> None:
    rig = load_rig(PAPER, [*QUICK, "law.name=structured-kalman"])
    work = jobs(rig, RIGS, 3, 0.7, seed=9)
    figures = run_chunk(work[0])
    (saved,) = save_worst(PAPER, rig, 9, False, [2], tmp_path)
    assert reproduce(saved, 0.7, figures.max_error[2])
    assert not reproduce(saved, 0.7, figures.max_error[1])
    assert load_rig(saved).plant == plant_rig(rig, 9, 2, False).plant
    assert "# The stage of Xu" in saved.read_text()


def test_a_sweep_without_a_steady_window_is_refused() -> None:
    with pytest.raises(RigError, match="steady window begins"):
        jobs(load_rig(PAPER), RIGS, 10, 3.0, seed=1)
    with pytest.raises(RigError, match="stage_fd"):
        jobs(load_rig(PAPER, ["wire.jitter=1e-5"]), RIGS, 10, 20.0, seed=1)


def test_every_law_can_be_tuned_and_points_turn_back_into_gains() -> None:
    for law, space in SPACE.items():
        for axis in range(2):
            bench = Bench(load_rig(PAPER, [f"law.name={law}"]), law, axis, [Trial("own", {}, 4.0)])
            points = np.random.default_rng(1).random((3, len(space)))
            gains = bench.gains(points)
            for candidate in range(3):
                one = {name: float(values[candidate]) for name, values in gains.items()}
                assert bench.point(one) == pytest.approx(points[candidate], abs=1e-9)


@pytest.mark.parametrize("law", ["structured-kalman", "slotine-li"])
def test_a_rehearsal_equals_a_batch_bit_for_bit(law: str) -> None:
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
        rehearsal = Rehearsal(rig, axis, chosen[:2], 200, 600, 1)
        known = rig.law.effective_gains()
        gains = {key: np.full(2, float(np.broadcast_to(value, (2,))[axis])) for key, value in known.items()}
        gains = gains or {"rate": np.full(2, 0.15 / 1e-3)}
        figures = rehearsal.run(law, gains)
        assert np.all(figures.largest[:, 0] == largest[axis])
        assert np.all(figures.largest[:, 1] != largest[axis])
        late = Rehearsal(rig, axis, chosen, 200, 600, 1).run(law, gains)
        assert np.all(late.largest[:, :2] == figures.largest)
        assert np.all(late.largest[:, 2] != figures.largest[:, 0])


def test_late_and_lost_commands_in_a_rehearsal_are_those_of_the_wire() -> None:
    """Not the same numbers, as the wire draws its own, but the same size: what is tuned for is what happens."""
    changes = ["law.name=structured-kalman", "task.radius=0.1", "task.approach_s=0.5", "task.settle_s=0.5"]
    rig = load_rig(PAPER, changes)
    trials = [Trial("late", {}, 1.0, jitter=5e-5), Trial("lost", {}, 1.0, loss=0.01)]
    gains = {key: np.array([values[0]]) for key, values in rig.law.effective_gains().items()}
    rehearsed = Rehearsal(rig, 0, trials, 1000, 4000, 1).run("structured-kalman", gains).rms[0]
    for index, change in enumerate(("wire.jitter=5e-5", "wire.drop_probability=0.005")):
        report, _ = simulate(load_rig(PAPER, [*changes, change]), RIGS, 4.0)
        assert 0.5 < report.axes["x"]["rms_error"] / rehearsed[index] < 2.0


def test_a_search_lowers_the_cost_and_never_loses_its_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.tune.SETTLE_S", 0.2)
    monkeypatch.setattr("hil.tune.WINDOW_S", 0.2)
    rig = load_rig(PAPER, ["task.radius=0.01", "task.frequency_hz=4", "task.approach_s=0.2", "law.gains.kp=300"])
    for axis in range(2):
        bench = Bench(rig, "pd-feedforward", axis, [Trial("own", {}, 4.0), Trial("light", {}, 4.0, 0.8, 1.3)])
        start = bench.point(rig.law.effective_gains())
        before = bench.run(start[None]).cost[0]
        best, met = search(bench, 8, 3, 1, lambda ratio: None)
        after = bench.run(best[None]).cost[0]
        assert after < before
        trade = front(met)
        assert all(one[0] < two[0] and one[1] > two[1] for one, two in pairwise(trade))
        again, _ = search(bench, 8, 3, 1, lambda ratio: None)
        assert np.array_equal(again, best)
        assert rounded([bench.gains(best[None])] * 2)["kp"][0] == pytest.approx(bench.gains(best[None])["kp"][0], 1e-3)


def test_figures_are_tuned_on_many_tasks_and_plans_on_themselves() -> None:
    figures = trials(load_rig(PAPER))
    assert {trial.task["kind"] for trial in figures if "kind" in trial.task} == {"lissajous", "point_to_point"}
    assert any(trial.jitter for trial in figures)
    assert any(trial.loss for trial in figures)
    (plan,) = trials(load_rig(RIGS / "microscope.toml"))
    assert plan.rms


def test_found_gains_go_into_the_rig_file_and_nothing_else_changes(tmp_path: Path) -> None:
    target = tmp_path / "rig.toml"
    copy(PAPER, target)
    write_gains(target, "pd-feedforward", {"kp": [1.0, 2.0], "kd": [0.5, 0.25]}, "found by a test")
    text = target.read_text()
    assert "# found by a test" in text
    for line in PAPER.read_text().splitlines():
        assert line in text
    changed = load_rig(target)
    assert changed.law.tuned["pd-feedforward"] == {"kp": [1.0, 2.0], "kd": [0.5, 0.25]}
    assert changed.plant == load_rig(PAPER).plant
    assert tomlkit.parse(text)["law"]["tuned"]["structured-kalman"]  # type: ignore[index]


def test_knob_scales_follow_mass_rate_and_encoder() -> None:
    from hil.belief import rig_model

    model = rig_model(load_rig(PAPER))
    knob = SPACE["pd-feedforward"]["kp"]
    slow, fast = (knob_scale(knob, model, period, np.ones(2), 1e-7) for period in (2e-3, 1e-3))
    assert fast == pytest.approx(4 * slow)
    noise = SPACE["structured-kalman"]["measurement_noise"]
    assert knob_scale(noise, model, 1e-3, np.ones(2), 1e-7) * noise.low == pytest.approx(1e-7 / 12**0.5, rel=0.01)


def test_compare_runs_every_combination_asked_for() -> None:
    chosen = ["pid", "pd-feedforward" + LEARNING]
    work = cases(PAPER, chosen, QUICK, [500.0], corners=True, disturbed=True, seconds=1.0)
    assert len(work) == 2 * (5 + 5 + 1)
    assert {case.rate_hz for case in work} == {1000.0, 500.0}
    row = run_case(work[0])
    assert row["law"] == "pid"
    assert row["state"] == "ACTIVE"
    assert row["axes"]["x"]["max_error"] > 0
    with pytest.raises(RigError, match="the laws are"):
        cases(PAPER, ["magic"], [], [], corners=False, disturbed=False, seconds=1.0)


def test_the_velocity_table_ranks_a_model_of_the_error_above_differences(tmp_path: Path) -> None:
    from hil.velocity import compare_velocity

    rig = load_rig(PAPER, ["task.radius=0.1", "task.approach_s=0.5", "task.settle_s=0.5", "plant.modelling_error=0.3"])
    rows = {row["estimator"]: row["axes"]["x"]["rms_error"] for row in compare_velocity(rig, RIGS, 4.0)}
    assert rows["Kalman, constant acceleration of the error"] < 0.6 * rows["finite difference"]
    assert rows["Kalman, constant velocity of the error"] < 0.6 * rows["Kalman, constant velocity"]


def test_compare_on_the_command_line_writes_rows(tmp_path: Path) -> None:
    target = tmp_path / "rows.json"
    settings = [word for change in QUICK for word in ("--set", change)]
    result = CliRunner().invoke(
        build_app("compare"),
        [
            *("compare", str(PAPER), "--laws", "pid", "--seconds", "1", "--json", str(target)),
            *(*settings, "--picture", str(tmp_path / "c.png"), "--workers", "1"),
        ],
    )
    assert result.exit_code == 0, result.output
    assert '"law": "pid"' in target.read_text()
    assert (tmp_path / "c.png").stat().st_size > 1000
