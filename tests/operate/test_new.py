"""`hil new`: from a few words to a rig file on which check and sim pass; `hil explain`; completion in the shell."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from hil.analysis.stability import check_stability
from hil.cli.app import build_app
from hil.rig.file import load_rig
from hil.rig.plant_notes import plant_notes
from hil.rig.scaffold import LAYOUTS, AxisSketch, _move_s
from hil.rig.schema import RigError
from hil.studies.tune.search_space import space_of
from hil.virtual.sim import simulate
from tests.support.paths import ROOT

HIL = [sys.executable, "-m", "hil"]
INSTALLED = [sys.executable, "-c", "import sys; sys.argv[0] = 'hil'; from hil.__main__ import main; main()"]
FOUR = ["--axes", "x,y,z,theta", "--rotary", "theta", "--vertical", "z", "--mass", "0.5,0.5,0.3,1e-4"]
FOUR += ["--force", "10,10,10,0.1", "--travel", "0.05,0.05,0.02,1.0", "--encoder", "1e-8"]


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def hil(*words: str) -> Result:
    """A command in this process; what it raises is in the result. The words of a refusal are on one line."""
    return CliRunner(env={"COLUMNS": "300", "NO_COLOR": "1"}).invoke(build_app(words[0]), words)


@pytest.mark.long
@pytest.mark.parametrize(("layout", "flags"), [("stage_fd", []), *((layout, FOUR) for layout in LAYOUTS)])
def test_what_it_writes_passes_check_and_follows_its_task(layout: str, flags: list[str], tmp_path: Path) -> None:
    made = hil("new", "stage.toml", "--layout", layout, *flags)
    assert made.exit_code == 0, made.stderr
    checked = hil("check", "stage.toml")
    assert checked.exit_code == 0, checked.stdout + checked.stderr
    assert "less margin than is good" not in checked.stdout
    assert "ACTIVATE there would break a limit" not in checked.stdout  # from wherever the stage may stand
    rig = load_rig(tmp_path / "stage.toml")
    assert rig.bus.protocol == ("dbc:stage.dbc" if layout == "dbc" else layout)
    assert plant_notes(rig)[0].startswith("emulated stage of stage: mass, coulomb")
    report, _ = simulate(rig, tmp_path, 1.6)
    assert (report.state, report.faults) == ("ACTIVE", {})
    for name, figures in report.axes.items():
        low, high = rig.axes[name].limits.position
        assert figures["max_error"] < 1e-3 * (high - low)
        assert figures["peak_force"] < 0.8 * rig.axes[name].limits.force


def test_a_travel_of_a_thousand_counts_gets_limits_that_a_count_keeps(tmp_path: Path) -> None:
    """A count in a tick is 1.45 mm/s here, and 2 m/s a metre of travel would be 2.9."""
    made = hil("new", "stage.toml", "--axes", "x", "--mass", "0.0365", "--travel", "0.00147", "--encoder", "1.45e-6",
               "--force", "167")  # fmt: skip
    assert made.exit_code == 0, made.stderr
    report, _ = simulate(load_rig(tmp_path / "stage.toml"), tmp_path, 3.0)
    assert (report.state, report.faults) == ("ACTIVE", {})


@pytest.mark.parametrize(("mass", "force", "seconds"), [(5.0, 0.5, 4.2), (0.2, 0.02, 4.2), (5.0, 50.0, 1.2)])
def test_the_first_move_takes_a_fifth_of_the_rated_force_or_half_the_speed(
    mass: float, force: float, seconds: float
) -> None:
    """Over 0.06 of the 0.1 m of travel: 5.77 m d / T^2 is a fifth of the force, or 1.875 d / T a tenth of a metre."""
    assert _move_s((AxisSketch("x", mass, 0.1, 1e-7, force, 0.0),)) == seconds


def test_the_file_holds_what_was_said(tmp_path: Path) -> None:
    assert hil("new", "mine.toml", *FOUR, "--watchdog", "0.02", "--rate", "500").exit_code == 0
    rig = load_rig(tmp_path / "mine.toml")
    assert (rig.name, rig.rate_hz, rig.axis_names) == ("mine", 500.0, ["x", "y", "z", "theta"])
    assert (rig.drives.watchdog_s, rig.drives.brake) == (0.02, [False, False, True, False])
    assert [axis.kind for axis in rig.axes.values()] == ["linear", "linear", "linear", "rotary"]
    assert {axis.encoder_resolution for axis in rig.axes.values()} == {1e-8}
    assert [axis.model.mass for axis in rig.axes.values()] == [0.5, 0.5, 0.3, 1e-4]
    assert rig.axes["z"].model.gravity == pytest.approx(-0.3 * 9.81)
    assert rig.axes["theta"].limits.position == [-0.5, 0.5]


@pytest.mark.long
def test_at_a_terminal_it_asks_for_what_no_flag_says(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    asked = subprocess.Popen(
        [*HIL, "new", "asked.toml", "--layout", "cia402", "--mass", "2"],
        stdin=theirs, stdout=theirs, stderr=theirs, close_fds=True,
    )  # fmt: skip
    os.close(theirs)
    os.write(ours, b"a,b\n\nb\n0.1\n\n60\n")  # axes, none turns, b is vertical, travel, encoder: as suggested, force
    said = b""
    while True:
        try:
            part = os.read(ours, 4096)
        except OSError:  # the other end is closed
            break
        said += part
    os.close(ours)
    assert asked.wait() == 0, said
    rig = load_rig(tmp_path / "asked.toml")
    assert rig.axis_names == ["a", "b"]
    assert {(axis.model.mass, axis.encoder_resolution, axis.rated_force) for axis in rig.axes.values()} == {
        (2.0, 1e-7, 60.0)
    }
    assert rig.axes["a"].model.gravity == 0.0
    assert abs(rig.axes["b"].model.gravity) > 19.0, "a weight that nobody was asked for would fall"
    assert (rig.drives.brake, rig.drives.brake_opening_s) == ([False, True], 0.05)
    assert rig.axes["a"].limits.position == [-0.05, 0.05]
    assert b"Encoder resolution" in said
    assert b"layout" not in said.split(b"written")[0].lower()


@pytest.mark.parametrize(
    ("flags", "reason"),
    [
        (["--layout", "magic"], "--layout magic: expected one of stage_fd"),
        (["--axes", "x,x"], "--axes x,x: expected one to 4 different names"),
        (["--axes", "a,b,c,d,e"], "expected one to 4"),
        (["--mass", "1,2,3"], "--mass 1,2,3: expected a number"),
        (["--mass", "-1"], "--mass -1: expected a number from 1e-15 to 1e15"),
        (["--encoder", "nan"], "--encoder nan"),
        (["--rotary", "q"], "--rotary q: the axes are x, y"),
        (["--vertical", "x", "--mass", "100"], "gravity and friction take"),
    ],
)
def test_what_makes_no_stage_is_refused_and_nothing_is_written(flags: list[str], reason: str, tmp_path: Path) -> None:
    refused = hil("new", "stage.toml", *flags)
    assert refused.exit_code == 2
    assert reason in refused.stderr
    assert not list(tmp_path.glob("stage*"))


def test_a_rate_the_bus_cannot_carry_is_refused_with_why(tmp_path: Path) -> None:
    refused = hil("new", "stage.toml", "--layout", "cia402", "--rate", "5000")
    assert isinstance(refused.exception, RigError)
    assert "at 5000 Hz: bus.protocol = 'cia402' at 1000000 bit/s does not fit" in str(refused.exception)
    assert not list(tmp_path.glob("stage*"))


def test_a_file_that_is_there_already_stays(tmp_path: Path) -> None:
    (tmp_path / "stage.toml").write_text("mine")
    refused = hil("new", "stage.toml")
    assert refused.exit_code == 2
    assert "exists already" in refused.stderr
    assert (tmp_path / "stage.toml").read_text() == "mine"


def test_explain_says_meaning_unit_range_and_default(tmp_path: Path) -> None:
    told = hil("explain", "safety.stop_s")
    assert told.exit_code == 0
    assert told.stdout.splitlines() == [
        "safety.stop_s: a damped stop ends within this",
        "  type     number",
        "  unit     s",
        "  allowed  more than 0, at most 0.5",
        "  default  0.05",
    ]
    unknown = hil("explain", "safety.stop")
    assert unknown.exit_code == 2
    assert "the nearest is safety.stop_s" in unknown.stderr
    assert "watchdog_s" in hil("explain", "drives").stdout


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("hil expl", ["explain"]),
        ("hil new stage.toml --rot", ["--rotary"]),
        ("hil explain axes.x.limits.sp", ["axes.x.limits.speed"]),
        ("hil explain drives.w", ["drives.watchdog_s"]),
    ],
)
def test_the_shell_completes_commands_flags_and_keys(typed: str, offered: list[str]) -> None:
    position = str(len(typed.split()) - 1)
    asked = {"_HIL_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": position}
    done = subprocess.run(INSTALLED, env={**os.environ, **asked}, capture_output=True, text=True, check=False)
    assert done.stdout.split() == offered


def test_the_law_that_the_docs_show_runs_on_it_with_good_margins(tmp_path: Path) -> None:
    page = (ROOT / "docs/laws.md").read_text()
    (code,) = [part.partition("```")[0] for part in page.split("```python\n") if "class Mine(Law)" in part]
    (tmp_path / "mine.py").write_text(code)
    assert hil("new", "stage.toml").exit_code == 0
    rig = load_rig(tmp_path / "stage.toml", ["law.name=./mine.py:Mine"])
    report, _ = simulate(rig, tmp_path, 1.6)
    assert (report.state, report.faults, report.law_failure) == ("ACTIVE", {}, "")
    margins = check_stability(rig).axes.values()
    assert min(axis.gain_db for axis in margins) > 6.0
    assert min(axis.phase_deg for axis in margins) > 30.0
    assert list(space_of(rig, rig.law.name)) == ["kp", "kd"]
