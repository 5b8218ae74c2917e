"""What a run has learnt over its repeats: kept beside it, begun with by the next, refused where the rig is another."""

import json
from pathlib import Path

import numpy as np
import pytest
import typer

from hil.control.laws.presliding_kalman import KEPT
from hil.rig.file import learning_hash, load_rig, rig_hash, without_learnt
from hil.rig.schema import RigError
from hil.telemetry.recorder import LockstepRecorder
from hil.telemetry.recording import Recording
from hil.virtual.learnt import learnt, learnt_of_run
from hil.virtual.replay import replay_run
from hil.virtual.sim import simulate
from tests.support.paths import RIGS

SETS = (
    "law.name=presliding-kalman", "law.iterative_learning=true", "task.frequency_hz=5.0", "task.radius=1e-3",
    "task.approach_s=0.1", "plant.presliding=5e-6",
)  # fmt: skip
SECONDS, FEW = 3.0, 0.9  # s: 14 repeats; 4 of them


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """A folder with a rig file, a recording of it and what it learnt; and that run's errors."""
    folder = tmp_path_factory.mktemp("learnt")
    rig_file = folder / "rig.toml"
    rig_file.write_text((RIGS / "paper.toml").read_text())
    rig = load_rig(rig_file, SETS)
    recorder = LockstepRecorder(folder / "run.mcap", rig, rig_file)
    _, traces = simulate(rig, folder, SECONDS, observer=recorder.observe)
    recorder.close()
    learnt(folder / "run.mcap", None)
    return folder, traces.error


def rms(error: np.ndarray, begin: float, end: float) -> np.ndarray:
    part = error[round(begin * 1000) : round(end * 1000)]
    root: np.ndarray = np.sqrt(np.mean(part * part, axis=0))
    return root


@pytest.mark.long
def test_the_next_run_begins_where_the_last_one_ended(kept: tuple[Path, np.ndarray]) -> None:
    folder, first = kept
    rig = load_rig(folder / "rig.toml", [*SETS, "law.learnt=learnt.json"])
    report, traces = simulate(rig, folder, FEW)
    assert report.state == "ACTIVE"
    assert (rms(traces.error, 0.3, FEW) < 0.5 * rms(first, 0.3, FEW)).all()
    assert (rms(traces.error, 0.3, FEW) < 1.5 * rms(first, SECONDS - 0.6, SECONDS)).all()


@pytest.mark.long
def test_a_run_that_began_with_it_replays(kept: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    """The recording has what was learnt in it: the file is not needed."""
    folder, _ = kept
    rig = load_rig(folder / "rig.toml", [*SETS, "law.learnt=learnt.json"])
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, folder / "rig.toml")
    simulate(rig, folder, 0.4, observer=recorder.observe)
    recorder.close()
    assert replay_run(tmp_path / "run.mcap").different == 0


@pytest.mark.parametrize("change", ["task.radius=2e-3", "law.gains.integral=0.05", "axes.x.model.mass=0.03"])
def test_another_rig_is_refused(kept: tuple[Path, np.ndarray], change: str) -> None:
    with pytest.raises(RigError, match="learnt on another rig"):
        load_rig(kept[0] / "rig.toml", [*SETS, "law.learnt=learnt.json", change])


def test_the_file_is_checked_before_anything_moves(kept: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    folder, _ = kept
    document = json.loads((folder / "learnt.json").read_text())
    assert document["rig_hash"] == learning_hash(load_rig(folder / "rig.toml", SETS))
    wrong = folder / "wrong.json"
    for text, said in (
        ("{", "no file of"),
        (json.dumps(document | {"state": {"x": document["state"]["x"]}}), "state.y"),
        (json.dumps(document | {"state": {"x": [1.0], "y": [1.0, 2.0]}}), "different lengths"),
        (json.dumps(document).replace(str(document["state"]["x"][0]), "NaN", 1), "finite"),
    ):
        wrong.write_text(text)
        with pytest.raises(RigError, match=said):
            load_rig(folder / "rig.toml", [*SETS, "law.learnt=wrong.json"])
    with pytest.raises(RigError, match="No such file"):
        load_rig(folder / "rig.toml", [*SETS, "law.learnt=none.json"])
    with pytest.raises(RigError, match="learnt on another rig"):
        load_rig(folder / "rig.toml", [*SETS, "law.learnt=learnt.json", "law.iterative_learning=false"])


def test_another_law_drops_it(kept: tuple[Path, np.ndarray]) -> None:
    folder, _ = kept
    lines = (folder / "rig.toml").read_text().replace("[law]\n", '[law]\nlearnt = "learnt.json"\n', 1)
    (folder / "with.toml").write_text(lines)
    rig = load_rig(folder / "with.toml", ["law.name=pd-feedforward"])
    assert rig.law.learnt == ""
    assert rig_hash(rig) == rig_hash(without_learnt(rig))


def test_a_run_that_learns_nothing_has_nothing_to_keep(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig_file = RIGS / "paper.toml"
    rig = load_rig(rig_file)
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, rig_file)
    simulate(rig, RIGS, 0.05, observer=recorder.observe)
    recorder.close()
    with pytest.raises(typer.Exit):
        learnt(tmp_path / "run.mcap", None)
    assert "keeps nothing" in capsys.readouterr().err
    assert not (tmp_path / "learnt.json").exists()


def test_what_was_learnt_of_a_recording_is_one_list_an_axis(kept: tuple[Path, np.ndarray]) -> None:
    rig, state = learnt_of_run(Recording(kept[0] / "run.mcap"))
    assert list(state) == rig.axis_names
    assert {len(values) for values in state.values()} == {KEPT + 200}
