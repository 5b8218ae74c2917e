"""Stages that users bring in place of our physics: found in every way, run by every command, trusted with nothing."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from hil.cli.app import build_app
from hil.rig.file import build_rig, load_rig, rig_hash
from hil.rig.schema import RigConfig, RigError
from hil.studies.fault_campaign.matrix import plan_chunks, run_chunk
from hil.studies.sweep.plants import jobs, reproduce, save_worst
from hil.studies.sweep.plants import run_chunk as run_plants
from hil.studies.tune.candidate_simulation import Trial
from hil.studies.tune.objective import Bench
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.replay import replay_run
from hil.virtual.sim import simulate, usable
from sim_plant.config import PlantError
from sim_plant.physics.stage import Stage, Truth
from sim_plant.user_stage import stage_of, stage_problems
from tests.support.paths import RIGS, ROOT

QUICK = ["task.radius=0.01", "task.approach_s=0.2", "task.settle_s=0.1"]
LEANING = ["plant.stage=./leaning.py:Leaning", "law.name=structured-kalman", *QUICK]
MASS = """
import numpy
from hil import Plant


class Mass(Plant):
    def acceleration(self, position, velocity, force):
        return force / self.truth.mass


class Wrong(Mass):
    def __init__(self, truth, how="raises"):
        super().__init__(truth)
        if how == "unmade":
            raise RuntimeError("no data")
        self.how = how

    def acceleration(self, position, velocity, force):
        if self.time > 0.05:
            if self.how == "raises":
                return 1 / 0
            if self.how == "exits":
                raise SystemExit(3)
            if self.how == "not a number":
                return position * numpy.nan
            if self.how == "shape":
                return numpy.zeros(3)
        return super().acceleration(position, velocity, force)


class Bent(Mass):
    def reading(self):
        return 1.01 * self.position
"""


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    for path in (RIGS / "paper.toml", ROOT / "examples/stages/leaning.py"):
        shutil.copy(path, tmp_path)
    (tmp_path / "mass.py").write_text(MASS)
    return tmp_path / "paper.toml"


def leaning(rig_file: Path, *more: str) -> RigConfig:
    return load_rig(rig_file, [*LEANING, *more])


@pytest.mark.long
def test_a_users_stage_is_simulated(rig_file: Path) -> None:
    rig = leaning(rig_file)
    report, _ = simulate(rig, rig_file.parent, 1.0)
    assert (report.state, report.faults) == ("ACTIVE", {})
    assert max(axis["max_error"] for axis in report.axes.values()) < 1e-3
    soft, _ = simulate(leaning(rig_file, "plant.parameters.lean=0.0"), rig_file.parent, 1.0)
    assert soft.trace_sha256 != report.trace_sha256
    assert simulate(rig, rig_file.parent, 1.0)[0].trace_sha256 == report.trace_sha256


def test_a_free_mass_moves_as_ours_does(rig_file: Path) -> None:
    free = ["plant.friction_scale=0.0"]
    rig = load_rig(rig_file, [*free, "plant.stage=./mass.py:Mass"])
    ours = load_rig(rig_file, free)
    truth = Truth.from_config(rig.plant, 2, rig.axis_names)
    stages = [stage_of(config.plant, truth, [0.1, -0.2]) for config in (rig, ours)]
    assert [type(stage) is Stage for stage in stages] == [False, True]
    for force in ([1.0, -2.0], [0.5, 0.0], [-3.0, 1.0]):
        for stage in stages:
            stage.advance(1_000_000, force)
    np.testing.assert_allclose(stages[0].position, stages[1].position, rtol=1e-12)
    np.testing.assert_allclose(stages[0].velocity, stages[1].velocity, rtol=1e-12)
    before = stages[0].positions
    looked = stages[0].peek(500_000, [1.0, 1.0])[0].tolist()
    assert stages[0].positions == before != looked


def test_its_encoders_may_show_something_else_than_its_position(rig_file: Path) -> None:
    rig = load_rig(rig_file, ["plant.stage=./mass.py:Bent"])
    stage = stage_of(rig.plant, Truth.from_config(rig.plant, 2, rig.axis_names), [0.1, -0.2])
    stage.advance(5_000_000, [1.0, 1.0])
    assert stage.readings() == stage.read().tolist() == [1.01 * place for place in stage.positions]
    ahead, shown = stage.peek(2_000_000, [1.0, 1.0])[0], stage.peek_reading(2_000_000, [1.0, 1.0], 1)
    assert shown == 1.01 * ahead[1] != stage.reading(1)
    run = simulate(rig.model_copy(update={"task": rig.task.model_copy(update={"kind": "hold"})}), rig_file.parent, 0.3)
    assert run[0].faults == {}


def test_a_brake_stops_and_holds_it(rig_file: Path) -> None:
    rig = load_rig(rig_file, ["plant.stage=./mass.py:Mass"])
    stage = stage_of(rig.plant, Truth.from_config(rig.plant, 2, rig.axis_names), [0.0, 0.0])
    stage.advance(5_000_000, [1.0, 1.0])
    stage.clamp([3.0, 0.0])
    stage.advance(50_000_000, [1.0, 0.0])
    there = stage.positions
    stage.advance(50_000_000, [2.0, 0.0])
    assert stage.velocities[0] == 0.0
    assert stage.positions[0] == there[0]
    assert stage.positions[1] > there[1]


@pytest.mark.parametrize(("name", "text"), [
    ("flexur", "the nearest is flexure; the stages are ideal"),
    ("./none.py:Mass", "none.py: No such file"),
    ("./mass.py:Weight", "'Weight' is no class with begin and advance"),
])  # fmt: skip
def test_a_stage_that_is_not_to_be_had_is_refused(name: str, text: str, rig_file: Path) -> None:
    with pytest.raises(RigError) as caught:
        usable(load_rig(rig_file, [f"plant.stage={name}"]), rig_file)
    assert text in str(caught.value)


@pytest.mark.parametrize(("how", "text"), [("raises", "ZeroDivisionError"), ("unmade", "RuntimeError: no data")])
def test_check_refuses_a_stage_that_is_none(how: str, text: str, rig_file: Path) -> None:
    rig = load_rig(rig_file, ["plant.stage=./mass.py:Wrong", f"plant.parameters.how={how}"])
    (problem,) = stage_problems(rig.plant, rig.axis_names)
    assert text in problem
    assert stage_problems(leaning(rig_file).plant, rig.axis_names) == []
    assert stage_problems(load_rig(rig_file).plant, rig.axis_names) == []


@pytest.mark.parametrize(("override", "text"), [
    ("plant.parameters.stifness=1.0", "it cannot be made: "),
    ("plant.parameters.stiffness='much'", "./leaning.py:20: "),
])  # fmt: skip
def test_its_parameters_are_its_own_to_check(override: str, text: str, rig_file: Path) -> None:
    with pytest.raises((RigError, PlantError)) as caught:
        simulate(usable(leaning(rig_file, override), rig_file), rig_file.parent, 0.1)
    assert text in str(caught.value)


@pytest.mark.parametrize(("how", "text"), [
    ("raises", "./mass.py:21: ZeroDivisionError"),
    ("exits", "./mass.py:23: SystemExit: 3"),
    ("not a number", "its position is [nan, nan], expected 2 finite numbers"),
    ("shape", "./mass.py:"),
])  # fmt: skip
def test_a_stage_that_goes_wrong_ends_the_run_with_its_line(how: str, text: str, rig_file: Path) -> None:
    rig = load_rig(rig_file, ["plant.stage=./mass.py:Wrong", f"plant.parameters.how={how}"])
    with pytest.raises(PlantError) as caught:
        simulate(rig, rig_file.parent, 0.2)
    assert text in str(caught.value)


def test_it_travels_with_the_rig_and_its_recording_replays(rig_file: Path, tmp_path: Path) -> None:
    rig = leaning(rig_file)
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, rig_file)
    simulate(rig, rig_file.parent, 0.4, observer=recorder.observe)
    recorder.close()
    (rig_file.parent / "leaning.py").unlink()
    assert replay_run(tmp_path / "run.mcap").different == 0
    again = build_rig(json.loads(rig.model_dump_json()))
    assert rig_hash(again) == rig_hash(rig)
    assert simulate(again, rig_file.parent, 0.4)[0].trace_sha256


@pytest.mark.long
def test_a_sweep_varies_its_masses_and_reproduces_singly(rig_file: Path, tmp_path: Path) -> None:
    rig = leaning(rig_file)
    (job,) = jobs(rig, rig_file.parent, 2, 0.8, seed=1)
    figures = run_plants(job)
    assert figures.max_error[0].tolist() != figures.max_error[1].tolist()
    (path,) = save_worst(rig_file, rig, 1, False, [1], tmp_path)
    assert reproduce(path, 0.8, figures.max_error[1])


@pytest.mark.slow
def test_tune_tries_its_candidates_on_it(rig_file: Path) -> None:
    rig = load_rig(rig_file, ["plant.stage=./leaning.py:Leaning", "task.radius=1e-3"])
    bench = Bench(rig, "pd-feedforward", 0, [Trial("own", {"approach_s": 0.2}, 4.0)])
    soft = Bench(rig.model_copy(update={"plant": rig.plant.model_copy(update={"parameters": {"stiffness": 0.0}})}),
                 "pd-feedforward", 0, [Trial("own", {"approach_s": 0.2}, 4.0)])  # fmt: skip
    points = np.full((2, len(bench.space)), 0.5)
    assert bench.run(points).error.tolist() != soft.run(points).error.tolist()


def test_a_slice_of_the_fault_campaign_passes_on_it(rig_file: Path) -> None:
    chunks = plan_chunks(leaning(rig_file), rig_file.parent, stride=60)
    cells = [cell for chunk in (chunks[4], chunks[8]) for cell in run_chunk(chunk)]
    assert [f"{cell.trial}: {cell.why}" for cell in cells if not cell.passed] == []
    assert cells


@pytest.mark.long
@pytest.mark.parametrize(
    "words", [["sim", "--seconds", "0.6"], ["compare", "--laws", "pd-feedforward", "--seconds", "1"]]
)
def test_commands_take_a_users_stage(words: list[str], rig_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(rig_file.parent)
    overrides = [word for override in LEANING for word in ("--set", override)]
    done = CliRunner().invoke(build_app(words[0]), [words[0], str(rig_file), *words[1:], *overrides])
    assert done.exit_code == 0, done.output
