"""`hil identify`: what it writes, what it does not, its exit status, and the next step that it prints."""

from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import pytest

from hil.cli.app import main
from hil.cli.exit_status import EXIT_FAULT, EXIT_UNAVAILABLE
from hil.identify import command
from hil.identify.command import EXIT_REFUSED
from hil.identify.estimate import Estimate
from hil.identify.findings import Findings
from hil.rig.file import load_rig
from hil.rig.shipped import by_name
from hil.runs.api import simulate
from tests.identify import rigs

USAGE = 2
MASS, PRESLIDING = Estimate(1.25, 0.01, "kg"), "below Coulomb friction the axis moves 1 encoder counts"


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of it, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    file = Path("stage.toml")
    file.write_text(by_name("rigs", Path("paper")).read_text(encoding="utf-8"), encoding="utf-8")
    return file


Command = Callable[..., tuple[int, str]]  # words of a command, or findings and words: exit status and text


@pytest.fixture
def hil(rig: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    def gave(*words: str) -> tuple[int, str]:
        monkeypatch.setattr("sys.argv", ["hil", "identify", *words])
        with pytest.raises(SystemExit) as ended:
            main()
        told = capsys.readouterr()
        return int(ended.value.code or 0), told.out + told.err

    return gave


@pytest.fixture
def found(hil: Command, monkeypatch: pytest.MonkeyPatch) -> Command:
    """The command whose experiments on X find this."""

    def gave(findings: Findings, *words: str) -> tuple[int, str]:
        monkeypatch.setattr(command, "run_experiments", lambda *_: {"x": findings})
        return hil("stage.toml", "--axes", "x", *words)

    return gave


@pytest.mark.replaces_methods
def test_what_was_found_is_written(found: Command) -> None:
    """An axis without a resonance is nothing refused."""
    findings = Findings(found={"mass": MASS}, refused={"mode": "no resonance between 4 and 398 Hz"})
    assert found(findings, "--write", "new.toml")[0] == 0
    axis = load_rig(Path("new.toml")).axes["x"]
    assert axis.model.mass == 1.25
    assert axis.measured is not None
    assert axis.measured.evidence.startswith(f"hil {version('hil')}, in virtual time")
    status, text = found(findings, "--write", "new.toml")
    assert (status, "new.toml exists" in text) == (USAGE, True)


@pytest.mark.replaces_methods
def test_nothing_is_written_where_something_is_refused_until_that_is_accepted(found: Command) -> None:
    findings = Findings(found={"mass": MASS}, refused={"presliding": PRESLIDING, "viscous": "one speed"})
    status, text = found(findings, "--write", "new.toml")
    again = "hil identify stage.toml --axes x --write new.toml --accept presliding,viscous"
    assert (status, again in text, Path("new.toml").exists()) == (EXIT_REFUSED, True, False)
    status, text = found(findings, "--write", "new.toml", "--accept", "presliding")
    assert (status, Path("new.toml").exists()) == (EXIT_REFUSED, False), "one of two"
    assert "refused: viscous; nothing is written" in text
    assert text.rstrip().endswith("--accept presliding --accept presliding,viscous"), "the last one counts"
    assert found(findings, *again.split()[5:])[0] == 0
    before, after = load_rig(Path("stage.toml")).axes["x"].model, load_rig(Path("new.toml")).axes["x"].model
    assert after == before.model_copy(update={"mass": 1.25}), "the others are left as they were"
    status, text = found(findings, "--accept", "presliding,viscus")
    assert (status, "--accept viscus: it was not refused" in text) == (EXIT_REFUSED, True), "viscous still is"


@pytest.mark.replaces_methods
def test_a_refused_live_recording_can_be_measured_again(hil: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same command takes the recording that is kept, and is refused again."""
    findings = Findings(found={"mass": MASS}, refused={"frequency": "1 pairs of passes (at least 4)"})
    monkeypatch.setattr(command, "_found_live", lambda *_, **__: ({"x": findings}, "live"))
    status, text = hil("stage.toml", "--live", "--yes", "--out", "kept", "--set", "bus.interface=local")
    assert status == EXIT_REFUSED
    assert "  rm -r kept/x-frequency\n  hil identify stage.toml --live --yes --out kept" in text


@pytest.mark.replaces_methods
def test_a_dry_run_shows_what_would_change_and_writes_nothing(found: Command) -> None:
    status, text = found(Findings(found={"mass": MASS}), "--write", "new.toml", "--dry-run")
    assert (status, [path.name for path in Path().iterdir()]) == (0, ["stage.toml"])
    assert "mass = 1.25" in "".join(line for line in text.splitlines() if line.startswith("+"))
    assert "next: hil identify stage.toml --axes x --write new.toml\n" in text


@pytest.mark.replaces_methods
def test_a_file_that_was_asked_for_and_has_nothing_new_is_not_written(found: Command) -> None:
    rough = Findings(found={"push_coulomb": Estimate(1.2, 0.3, "N")})
    assert found(rough)[0] == 0
    status, text = found(rough, "--write", "new.toml")
    assert (status, Path("new.toml").exists()) == (EXIT_REFUSED, False)
    assert "new.toml is not written: no value of the model was found" in text


@pytest.mark.replaces_methods
def test_an_experiment_that_ended_in_a_fault_is_told_before_all_else(found: Command) -> None:
    ended = Findings(refused={"push": "the run ended in SPEED"}, ended="SPEED")
    status, text = found(ended, "--write", "new.toml")
    assert (status, Path("new.toml").exists()) == (EXIT_FAULT, False)
    assert "push refused: the run ended in SPEED" in text


def test_a_rig_is_not_moved_without_a_terminal(hil: Command) -> None:
    words = ("stage.toml", "--live", "--set", "bus.interface=socketcan", "--out", "identified")
    status, text = hil(*words)
    assert (status, "needs a terminal" in text, Path("identified").exists()) == (USAGE, True, False)
    assert hil("stage.toml", "--live", "--yes", "--axes", "q")[0] == USAGE
    assert not Path("runs").exists()
    status, text = hil("stage.toml", "--yes")
    assert (status, "of --live alone" in text) == (USAGE, True)


def test_a_recording_is_identified_as_it_is_named(tmp_path: Path, hil: Command) -> None:
    task = {"kind": "point_to_point", "axes": ["x"], "target": [2e-3], "move_s": 0.15, "dwell_s": 0.1}
    simulate(rigs.one_axis(task=task, law={"name": "pid"}), 3.0, record=tmp_path / "run.mcap")
    status, text = hil("stage.toml", "--axes", "x", "--from", "run.mcap")
    assert status in (0, EXIT_REFUSED)
    assert "hil identify stage.toml --axes x --from run.mcap --write NEW.toml" in text
    assert hil("stage.toml", "--axes", "y", "--from", "run.mcap")[0] not in (0, EXIT_UNAVAILABLE)
