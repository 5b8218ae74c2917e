"""An estimator that a user brings, in every command: whole runs behind it, from a recording, in other processes."""

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

import hil
from hil.cli.app import build_app
from hil.rig.file import build_rig, load_rig, rig_hash
from hil.studies.compare.cases import Case, run_case
from hil.studies.fault_campaign.matrix import displaced, plan_chunks, run_chunk
from hil.studies.sweep import plants
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.sim import simulate
from tests.support.paths import RIGS, ROOT

LUENBERGER = ROOT / "examples" / "estimators" / "luenberger.py"
QUICK = ["task.radius=0.01", "task.approach_s=0.2", "task.settle_s=0.1"]
MADE = ["estimator.name=./luenberger.py:Luenberger", *QUICK]
RUNNER = CliRunner()


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    """paper.toml in a folder of its own, with the estimator beside it."""
    for path in (RIGS / "paper.toml", LUENBERGER):
        shutil.copy(path, tmp_path)
    return tmp_path / "paper.toml"


@pytest.mark.long
@pytest.mark.parametrize("words", [["sim", "--seconds", "0.5"], ["check"]])
def test_commands_take_a_users_estimator(words: list[str], rig_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(rig_file.parent)
    keys = [word for key in MADE for word in ("--set", key)]
    for law, said in (("pd-feedforward", False), ("structured-kalman", True)):
        line = [words[0], str(rig_file), *words[1:], *keys, "--set", f"law.name={law}"]
        done = RUNNER.invoke(build_app(words[0]), line)
        assert done.exit_code == 0, done.output
        told = "Luenberger' changes nothing: law structured-kalman has an observer of its own" in done.output
        assert told == (said and words == ["check"])


def test_hil_check_accepts_it_or_says_why_not(rig_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(rig_file.parent)
    (rig_file.parent / "off.py").write_text(LUENBERGER.read_text().replace("m.ahead)", "m.ahead)[0]"))
    words = ["check", str(rig_file), "--estimator", "./off.py:Luenberger", "--json", "found.json"]
    done = RUNNER.invoke(build_app("check"), [*words, *(word for key in QUICK for word in ("--set", key))])
    assert done.exit_code == 1
    found = json.loads((rig_file.parent / "found.json").read_text())
    assert (found["law"], found["estimator"], found["accepted"]) == (None, "./off.py:Luenberger", False)
    contract, task, *others = found["steps"]
    assert (contract["passed"], contract["text"]) == (True, "PdFeedforward; gains: kp, kd; behind ./off.py:Luenberger")
    assert not task["passed"]
    assert "./off.py:25: TypeError: update returned" in task["text"]
    assert all(step["passed"] is None for step in others)


def test_its_text_is_part_of_the_rig_and_travels_with_it(rig_file: Path, tmp_path: Path) -> None:
    rig = load_rig(rig_file, MADE)
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, rig_file)
    report, _ = simulate(rig, rig_file.parent, 0.4, observer=recorder.observe)
    recorder.close()
    file = rig_file.parent / "luenberger.py"
    file.write_text(file.read_text() + "\n# another version\n")
    assert rig_hash(load_rig(rig_file, MADE)) != rig_hash(rig)
    file.unlink()
    replayed = hil.replay(tmp_path / "run.mcap", run_its_code=True)
    assert (replayed.ticks, replayed.different) == (400, 0)
    again = build_rig(json.loads(rig.model_dump_json()))
    assert rig_hash(again) == rig_hash(rig)
    assert simulate(again, rig_file.parent, 0.4)[0].trace_sha256 == report.trace_sha256
    recording = hil.Recording(tmp_path / "run.mcap")
    assert "class Luenberger" in recording.report(tmp_path / "run.html").read_text()


@pytest.mark.long
def test_compare_and_sweep_take_it_along(rig_file: Path, tmp_path: Path) -> None:
    row = run_case(Case(str(rig_file), "robust-pd", "nominal", 1000.0, MADE, 1.0))
    assert (row["state"], row["faults"]) == ("ACTIVE", {})
    rig = load_rig(rig_file, MADE)
    (job,) = plants.jobs(rig, rig_file.parent, 2, 0.8, seed=1)
    (rig_file.parent / "luenberger.py").unlink()
    figures = plants.run_chunk(job)
    (path,) = plants.save_worst(rig_file, rig, 1, False, [1], tmp_path)
    assert plants.reproduce(path, 0.8, figures.max_error[1])


def test_a_slice_of_the_fault_campaign_passes_with_it(rig_file: Path) -> None:
    chunks = plan_chunks(load_rig(rig_file, MADE[:1]), rig_file.parent, stride=60)
    cells = [cell for chunk in (chunks[4], chunks[8]) for cell in run_chunk(chunk)]
    assert [cell.why for cell in cells if not cell.passed] == [] != cells


@pytest.mark.slow
def test_a_third_of_the_fault_campaign_passes_with_it(rig_file: Path) -> None:
    rig = displaced(load_rig(rig_file, MADE[:1]))
    cells = [cell for chunk in plan_chunks(rig, rig_file.parent, stride=3) for cell in run_chunk(chunk)]
    assert [f"{cell.trial}, {cell.checkpoint}: {cell.why}" for cell in cells if not cell.passed] == []
    assert len(cells) > 400
