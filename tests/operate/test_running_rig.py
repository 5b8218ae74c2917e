"""RIG may be the name of a rig that only runs here: commands that read a rig file get it as it runs."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from hil.cli.app import build_app
from hil.live.ring import RingWriter
from hil.live.runtime_paths import runtime_paths
from hil.operate.running_rig import running_rig_file
from hil.rig.file import load_rig
from hil.rig.provenance import describe_run
from hil.rig.schema import RigConfig, RigError
from tests.support.paths import RIGS, ROOT

ONLY_RUNS = "bench-7"


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.chdir(tmp_path)


def running(rig: RigConfig, folder: Path = RIGS) -> RingWriter:
    """What a control process of the rig leaves for others, as long as it lives."""
    return RingWriter(runtime_paths(rig.name).ring, 16, period_ns=rig.period_ns, metadata=describe_run(rig, folder))


@pytest.fixture
def bench() -> Iterator[RigConfig]:
    """A rig of that name, with files of its own, which runs and has no rig file here."""
    rig = load_rig(RIGS / "paper-dbc.toml", [f"name={ONLY_RUNS}", "axes.x.limits.speed=5.5"])
    with running(rig):
        yield rig


def hil(*words: str) -> Result:
    return CliRunner(env={"COLUMNS": "300", "NO_COLOR": "1"}).invoke(build_app(words[0]), words)


def test_check_takes_the_rig_that_runs_with_what_it_runs_with(bench: RigConfig) -> None:
    checked = hil("check", ONLY_RUNS)
    assert checked.exit_code == 0, checked.stderr
    assert f"{ONLY_RUNS}: dbc" in checked.stdout
    with running_rig_file(ONLY_RUNS) as file:
        assert file is not None
        assert load_rig(file).axes == bench.axes
        assert {path.suffix for path in file.parent.iterdir()} == {".toml", ".dbc"}
    assert not file.exists(), "it lasts as long as the command"


@pytest.mark.parametrize("command", ["check", "sim", "faults", "drives", "evidence", "compare", "sweep", "inject"])
def test_every_command_that_reads_a_rig_says_so_where_none_is_of_that_name(command: str) -> None:
    done = hil(command, "bench-8")
    assert isinstance(done.exception, FileNotFoundError)
    assert done.exception.filename == "bench-8"


def test_a_running_rig_goes_behind_a_shipped_one_and_a_dead_one_counts_as_none(bench: RigConfig) -> None:
    with running(load_rig(RIGS / "paper.toml", ["rate_hz=500"])):
        assert "paper: stage_fd on 1000000 bit/s, data 5000000 bit/s, 1000 Hz" in hil("check", "paper").stdout
    with running_rig_file("paper") as file:
        assert file is None


def test_one_that_brings_a_law_of_its_own_is_refused_with_the_laws_name() -> None:
    law = f"{ROOT / 'examples' / 'laws' / 'lqr.py'}:Lqr"
    with (
        running(load_rig(RIGS / "paper.toml", [f"name={ONLY_RUNS}", f"law.name={law}"])),
        pytest.raises(RigError, match=rf"{ONLY_RUNS} runs, and brings law\.name = .*Lqr.*: name its rig file instead"),
        running_rig_file(ONLY_RUNS),
    ):
        raise AssertionError(sys.argv)
