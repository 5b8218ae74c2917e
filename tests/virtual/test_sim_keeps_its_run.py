"""`hil sim --keep` leaves a folder as a demo does, which other commands take as a run."""

from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from hil.cli.app import build_app

QUICK = ("--seconds", "0.4", "--set", "task.kind=hold")


def command(name: str, *words: str) -> Result:
    return CliRunner().invoke(build_app(name), [name, *words])


def test_a_run_is_kept_where_it_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert command("sim", "paper", *QUICK).exit_code == 0
    assert not (tmp_path / "runs").exists()
    done = command("sim", "paper", *QUICK, "--keep")
    assert done.exit_code == 0, done.output
    (folder,) = (tmp_path / "runs").iterdir()
    assert f"kept in runs/{folder.name}/" in done.output
    assert sorted(path.name for path in folder.iterdir()) == ["run.mcap", "tracking.png"]
    assert f"{folder.name}  paper  pd-feedforward  0.4 s" in command("runs").output


def test_a_folder_that_holds_a_run_is_refused(tmp_path: Path) -> None:
    assert command("sim", "paper", *QUICK, "--out", str(tmp_path / "mine")).exit_code == 0
    kept = (tmp_path / "mine" / "run.mcap").read_bytes()
    assert command("sim", "paper", *QUICK, "--out", str(tmp_path / "mine")).exit_code == 2
    assert (tmp_path / "mine" / "run.mcap").read_bytes() == kept
