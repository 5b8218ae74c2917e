"""`hil baseline`: a sound run is kept, and later ones of its rig and task are held against it, live and afterwards."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

import hil
from hil.cli.app import build_app
from hil.rig.baseline_file import baseline_path, read_baseline

TASK = ["task.kind=circle", "task.axes=['x', 'y']", "task.radius=0.002", "task.frequency_hz=0.5", "task.approach_s=0.5"]
QUICK = ["--seconds", "3", *(word for key in TASK for word in ("--set", key))]
NOISY = '[[fault]]\nkind = "plant_encoder_noise"\naxis = "y"\nat_s = 0.0\nvalue = 3e-8\n'


def command(name: str, *words: str) -> Result:
    return CliRunner(env={"COLUMNS": "200"}).invoke(build_app(name), [name, *words])


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a sound run, `one`, and its baseline in a state folder of its own."""
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    assert command("sim", "microscope-ideal", *QUICK, "--out", str(tmp_path / "one")).exit_code == 0
    done = command("baseline", str(tmp_path / "one"))
    assert done.exit_code == 0, done.output
    assert "reversal" in done.output
    return tmp_path


@pytest.mark.long
def test_a_run_that_is_noisy_from_its_start_is_told_while_it_runs_and_afterwards(kept: Path) -> None:
    (kept / "noisy.toml").write_text(NOISY)
    words = [*QUICK, "--set", "plant.seed=7", "--out", str(kept / "two")]
    assert command("sim", "microscope-ideal", *words).exit_code == 0
    same = command("baseline", str(kept / "two"), "--check")
    assert same.exit_code == 0, same.output
    assert f"as the baseline, {kept / 'one'}" in same.output
    words = [*QUICK, "--faults", str(kept / "noisy.toml"), "--out", str(kept / "three")]
    assert command("sim", "microscope-ideal", *words).exit_code == 0
    told = [event.line for event in hil.load_run(kept / "three").log if "accuracy lost" in event.line]
    assert "noise on y" in told[0]
    checked = command("baseline", str(kept / "three"), "--check")
    assert checked.exit_code == 1
    assert "s: noise on y: " in checked.output
    assert "noise on x" not in checked.output
    refused = command("baseline", str(kept / "three"))
    assert refused.exit_code == 74
    assert "no sound run" in refused.output
    compared = command("diff", str(kept / "two"), str(kept / "three"))
    assert "accuracy, the second against the first: " in compared.output
    assert "noise on y" in compared.output


@pytest.mark.long
def test_it_is_kept_by_rig_and_task_and_forgotten_on_request(kept: Path) -> None:
    rig = hil.load_rig("microscope-ideal", TASK)
    assert read_baseline(rig.config) is not None
    assert read_baseline(rig.changed("axes.x.limits.force=14").config) is not None
    assert read_baseline(rig.changed("task.radius=0.001").config) is None
    path = baseline_path(rig.config)
    for damage in ("", "[]", '{"format": 1}', path.read_text().replace('"windows": ', '"windows": -'), "{" * 5000):
        text = path.read_text()
        path.write_text(damage)
        assert read_baseline(rig.config) is None
        path.write_text(text)
    assert set(json.loads(path.read_text())["steady"]) == {"x", "y", "z", "theta"}
    assert "forgotten" in command("baseline", str(kept / "one"), "--forget").output
    assert "there was none" in command("baseline", str(kept / "one"), "--forget").output
    none = command("baseline", str(kept / "one"), "--check")
    assert none.exit_code == 74
    assert "keep one: hil baseline RUN" in none.output
