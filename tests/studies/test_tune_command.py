"""`hil tune` on the command line: what is searched on, what is kept, and what is written."""

from pathlib import Path
from shutil import copy

import numpy as np
import pytest
import tomlkit
from typer.testing import CliRunner

from hil.analysis.stability import refuse_unstable
from hil.cli.app import build_app
from hil.rig.file import load_rig
from hil.studies.tune.candidate_simulation import CandidateSimulation, Trial
from hil.studies.tune.objective import Bench, Kind, Margins, Outcome, kind_for, trials_of, unseen_trials
from hil.studies.tune.search import Judged, is_better, write_gains
from hil.studies.tune.stage_trials import StageTrials
from tests.studies.test_tune import MICROSCOPE, PAPER, QUICK, SHORT, SPACE


def tuned(rig_file: Path, *words: str) -> tuple[int, str]:
    settings = [word for change in SHORT for word in ("--set", change)]
    size = ["--population", "5", "--generations", "1", "--unseen", "2"]
    size += [] if "--trials" in words else ["--trials", "task"]  # quick; the stage's own have a test below
    result = CliRunner().invoke(build_app("tune"), ["tune", str(rig_file), *size, *settings, *words])
    return result.exit_code, result.output


@pytest.mark.long
@pytest.mark.usefixtures("short_trials")
def test_the_same_command_gives_the_same_gains_whatever_the_file_had(tmp_path: Path) -> None:
    """And the rig that it writes loads, says where its gains came from, and is one that `hil run` does not refuse."""
    target = tmp_path / "rig.toml"
    copy(PAPER, target)
    words = ["--law", "pid", "--seed", "3", "--margin", "1", "--phase-margin", "0"]
    code, output = tuned(target, *words)
    assert code == 0, output
    assert "1 generations of 5 candidates, after a first draw, for each of x, y; each of them " in output
    first = load_rig(target).law.tuned["pid"]
    assert set(first) == set(SPACE["pid"])
    assert "--law pid --population 5 --generations 1 --seed 3 --margin 1" in target.read_text()
    assert "--trials task --start middle --unseen 2" in target.read_text()
    assert "--set task.kind=point_to_point" in target.read_text()
    refuse_unstable(load_rig(target, ["law.name=pid", "rate_hz=200"]))
    poor = {"kp": [0.01, 0.01], "kd": [0.01, 0.01], "ki": [0.01, 0.01]}
    write_gains(target, "pid", poor, ["not found by anything"])
    tuned(target, *words)
    assert load_rig(target).law.tuned["pid"] == first
    assert target.read_text().count("[law.tuned.pid]") == 1
    code, output = tuned(target, *words, "--start", "rig")
    assert code == 0, output
    assert "--start rig" in target.read_text() or "No better gains found" in output


def outcome(ratio: float, cost: float, gain_db: float = 7.0) -> Outcome:
    """Of one candidate."""
    one = np.ones(1)
    return Outcome(1e-6 * one, ratio * one, one, one, gain_db * one, 40.0 * one, cost * one)


def test_gains_are_better_only_where_nothing_that_counts_is_worse() -> None:
    least, old = Margins(6.0, 30.0), Judged(outcome(3.0, 5.0), outcome(4.0, 6.0))
    better = Judged(outcome(2.9, 4.9), outcome(3.9, 5.9))
    assert is_better(better, old, least)
    assert not is_better(old, better, least)
    assert not is_better(old, old, least)
    assert not is_better(Judged(better.searched, outcome(4.1, 5.0)), old, least)  # fits what was searched alone
    assert not is_better(Judged(outcome(3.1, 4.0), better.unseen), old, least)
    assert not is_better(Judged(better.searched, outcome(3.9, 6.1)), old, least)
    short = Judged(outcome(1.0, 1.0, 3.0), outcome(1.0, 1.0, 3.0))
    assert not is_better(short, old, least)  # however accurate
    assert is_better(old, short, least)


@pytest.mark.slow
@pytest.mark.usefixtures("short_trials")
def test_better_gains_in_the_file_are_never_written_over(tmp_path: Path) -> None:
    """A good search first; a poor one after it changes no byte, and says what it would have traded."""
    target = tmp_path / "rig.toml"
    copy(PAPER, target)
    words = ["--law", "pid", "--margin", "1", "--phase-margin", "0"]
    code, output = tuned(target, *words, "--population", "16", "--generations", "3")
    assert code == 0, output
    assert "new gains: " in output
    good = target.read_text()
    for seed in ("5", "6"):
        code, output = tuned(target, *words, "--seed", seed, "--generations", "1")
        assert code == 0, output
        now = load_rig(target).law.tuned["pid"]
        if target.read_text() == good:
            assert "No better gains found" in output
            assert output.count("the file's gains are kept; those found are better at") == 2
        bench = Bench(load_rig(target, SHORT), "pid", 0, unseen_trials(load_rig(target, SHORT), 0, Kind.TASK, 2))
        before, after = (
            bench.judge({name: np.array([values[0]]) for name, values in gains.items()}).ratio[0]
            for gains in (tomlkit.parse(good)["law"]["tuned"]["pid"].unwrap(), now)
        )
        assert after <= before


@pytest.mark.slow
@pytest.mark.usefixtures("short_trials")
def test_a_search_on_what_stages_do_runs_and_says_what_it_traded(tmp_path: Path) -> None:
    target = tmp_path / "rig.toml"
    copy(PAPER, target)
    words = ["--law", "pd-feedforward", "--margin", "1", "--phase-margin", "0", "--trials", "stage"]
    code, output = tuned(target, *words)
    assert code == 0, output
    assert "paid for with: " in output or "worse at " in output


def test_the_trials_hold_what_stages_do() -> None:
    rig = load_rig(MICROSCOPE, ["axes.x.model.mode_frequency_hz=200"])
    stage = StageTrials(rig, 0)
    found = {trial.name: trial for trial in trials_of(rig, 0, Kind.STAGE) if trial.brief}
    lengths = [trial.plant["presliding"] for trial in found.values() if "presliding" in trial.plant]
    assert max(lengths) == pytest.approx(100.0 * min(lengths))
    keys = {key for trial in found.values() for key in trial.plant}
    assert {"presliding", "torque_lag", "cogging", "bias", "stribeck_scale", "modes", "ripple_amplitude"} <= keys
    assert sum(trial.step != 0.0 for trial in found.values()) == 2
    ringing = [found[name].plant["modes"][0]["frequency_hz"] for name in ("mode x 0.9", "mode x 1.1")]
    assert ringing == pytest.approx([180.0, 220.0])
    assert any(trial.task["target"][0] < 1e-4 for trial in found.values())
    assert not any("modes" in trial.plant for trial in StageTrials(rig, 1).real())  # no mode stated, none tried
    drawn = stage.unseen(6, 1, real=True)
    assert len({trial.plant["presliding"] for trial in drawn}) == 6
    assert not {trial.plant["presliding"] for trial in drawn} & set(lengths)
    assert stage.unseen(6, 1, real=True) == drawn
    assert kind_for(rig) is Kind.STAGE
    assert kind_for(load_rig(PAPER)) is Kind.IDEAL  # the paper's stage is ideal, and says so


def test_a_step_of_force_begins_in_the_middle_of_what_is_judged() -> None:
    """And only in its own trial: 0.3 N against the paper's X, which a PD law answers by 0.3 N / kp."""
    rig = load_rig(PAPER, [*QUICK, "law.name=pd-feedforward", "task.frequency_hz=2", "plant.modelling_error=0"])
    chosen = [Trial("step", {}, 4.0, step=0.3), Trial("none", {}, 4.0), Trial("bias", {}, 4.0, plant={"bias": 0.3})]
    gains = {key: np.array([values[0]]) for key, values in rig.law.effective_gains().items()}
    figures = CandidateSimulation(rig, 0, chosen, 300, 500, 1).run(rig.law, gains)
    step, none, _ = figures.largest[0]
    assert none < 0.05 * step
    assert 0.5e-4 < step < 3e-4
    assert figures.rms[0, 0] < 0.9 * figures.rms[0, 2]


@pytest.mark.long
@pytest.mark.usefixtures("short_trials")
def test_a_search_of_some_knobs_leaves_the_others_alone(tmp_path: Path) -> None:
    target = tmp_path / "rig.toml"
    copy(PAPER, target)
    write_gains(target, "pid", {"kp": [0.04, 0.02], "kd": [0.01, 0.005], "ki": [123.4, 56.78]}, [])
    code, output = tuned(target, "--law", "pid", "--margin", "1", "--phase-margin", "0", "--only", "kp,kd")
    assert code == 0, output
    found = load_rig(target).law.tuned["pid"]
    assert found["ki"] == [123.4, 56.78]
    assert found["kp"] != [0.04, 0.02]
    assert "--only kp,kd" in target.read_text()
    code, output = tuned(target, "--law", "pid", "--only", "kq")
    assert code != 0


@pytest.mark.long
@pytest.mark.usefixtures("short_trials")
def test_gains_without_the_margins_asked_for_are_not_written(tmp_path: Path) -> None:
    target = tmp_path / "rig.toml"
    copy(PAPER, target)
    code, output = tuned(target, "--law", "pd-feedforward", "--margin", "20", "--phase-margin", "80")
    assert code != 0
    assert target.read_text() == PAPER.read_text()
    assert "kp = [" in output  # shown all the same
