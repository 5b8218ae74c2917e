"""`hil sim` leaves a folder as a demo does, which other commands take as a run."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console
from typer.testing import CliRunner, Result

from hil.cli.app import build_app
from hil.events.table import Kind
from hil.telemetry.event_log import own_event
from hil.virtual.report_text import show_latched

QUICK = ("--seconds", "0.4", "--set", "task.kind=hold")


def command(name: str, *words: str) -> Result:
    return CliRunner().invoke(build_app(name), [name, *words])


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path


@pytest.mark.parametrize(("words", "files"), [
    ((), ["run.mcap"]),
    (("--keep",), ["run.mcap", "tracking.png"]),
])  # fmt: skip
def test_a_run_is_kept_and_listed(here: Path, words: tuple[str, ...], files: list[str]) -> None:
    done = command("sim", "paper", *QUICK, *words)
    assert done.exit_code == 0, done.output
    (folder,) = (here / "runs").iterdir()
    assert f"kept in runs/{folder.name}/" in done.output
    assert sorted(path.name for path in folder.iterdir()) == files
    assert f"{folder.name}  paper  pd-feedforward  0.4 s" in command("runs").output


def test_figures_of_a_run_that_was_too_short_to_settle_say_so(here: Path) -> None:
    assert "too short: not settled" in " ".join(command("sim", "paper", "--seconds", "0.4").output.split())
    assert "too short: not settled" in command("runs").output


def test_lost_accuracy_is_shown_beside_a_run_that_latched_nothing() -> None:
    lost, seen = (own_event(kind, "noise", 1) for kind in (Kind.ACCURACY_LOST, Kind.TICK_LATE))
    console = Console(record=True, width=200)
    show_latched(SimpleNamespace(events=[lost, seen], latched=None), console)
    assert console.export_text().splitlines() == [lost.line]


@pytest.mark.parametrize("words", [("--no-keep",), ("--record", "mine.mcap")])
def test_none_is_kept_where_it_is_not_wanted(here: Path, words: tuple[str, ...]) -> None:
    done = command("sim", "paper", *QUICK, *words)
    assert done.exit_code == 0, done.output
    assert not (here / "runs").exists()
    assert (here / "mine.mcap").exists() is ("--record" in words)


def test_where_no_folder_can_be_made_the_run_is_made_all_the_same_and_it_is_said(here: Path) -> None:
    (here / "runs").write_text("a file")
    done = command("sim", "paper", *QUICK)
    assert done.exit_code == 0, done.output
    assert "not kept: runs" in done.output
    assert command("sim", "paper", *QUICK, "--keep").exit_code != 0


def test_kept_runs_take_no_more_than_the_quota(here: Path) -> None:
    old = here / "runs" / "20200101-000000"
    old.mkdir(parents=True)
    (old / "run.mcap").write_bytes(bytes(1_000_001))
    assert command("sim", "paper", *QUICK, "--set", "telemetry.record_quota=1000000").exit_code == 0
    assert not (old / "run.mcap").exists()
    assert len(list((here / "runs").glob("*/run.mcap"))) == 1


def test_a_folder_that_holds_a_run_is_refused(tmp_path: Path) -> None:
    assert command("sim", "paper", *QUICK, "--out", str(tmp_path / "mine")).exit_code == 0
    kept = (tmp_path / "mine" / "run.mcap").read_bytes()
    assert command("sim", "paper", *QUICK, "--out", str(tmp_path / "mine")).exit_code == 2
    assert (tmp_path / "mine" / "run.mcap").read_bytes() == kept
