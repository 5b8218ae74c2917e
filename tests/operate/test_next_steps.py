"""The commands that a demo ends with, or that follow a refusal, can be pasted."""

import shlex
import subprocess
from pathlib import Path

import pytest

from hil.operate.command import Action, next_step
from hil.operate.demo import this_command
from hil.rig.extras import install_command
from hil.telemetry.command_client import Verdict
from tests.support.command_line import CommandLine
from tests.support.paths import ROOT


def test_a_module_that_was_run_by_python_is_named_as_it_was_run() -> None:
    words = shlex.split(this_command(str(ROOT / "hil" / "__main__.py")))
    done = subprocess.run([*words, "--version"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()[0]) == (0, "hil")


@pytest.mark.parametrize("place", ["/opt/hil/bin/hil", "/home/a b/bin/hil"])
def test_a_script_is_named_by_its_place(place: str) -> None:
    assert shlex.split(this_command(place)) == [str(Path(place))]


@pytest.mark.parametrize(
    ("action", "reason", "state", "steps"),
    [
        (Action.HOME, "HOME is not possible in state ACTIVE", "ACTIVE", ["command r stop", "command r home"]),
        (Action.ACTIVATE, "not possible", "FAULT", ["events r", "command r reset", "command r activate"]),
        (Action.ACTIVATE_HOLD, "not possible", "ESTOP", ["events r", "command r reset", "command r activate-hold"]),
        (Action.STOP, "stale: expired 45.7 ms before the tick that took it", "ACTIVE", ["command r stop", "estop r"]),
        (Action.STOP, "STOP is not possible in state FAULT", "FAULT", []),
        (Action.ACTIVATE, "refused: no recorder is alive", "READY", []),
    ],
)
def test_a_refused_command_is_told_with_what_to_do_next(
    action: Action, reason: str, state: str, steps: list[str]
) -> None:
    told = next_step(action, "r", Verdict(False, reason, state))
    places = [told.index(f"hil {step}") for step in steps]
    assert places == sorted(places)
    assert bool(told) == bool(steps)


def test_a_missing_extra_is_installed_where_hil_is() -> None:
    program, *words = shlex.split(install_command("page"))
    assert words == ["-m", "pip", "install", "hil[page]"]
    done = subprocess.run([program, "-c", "import hil"], cwd=ROOT, check=False)
    assert done.returncode == 0


@pytest.mark.parametrize("words", ["home", "move x=1mm", "jog x=1mm/s", "command stop", "accuracy --live"])
def test_a_rig_that_does_not_run_is_told_with_how_to_start_it(
    words: str, hil_here: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    verb, *rest = words.split()
    here = hil_here(verb, "my-stage", *rest)
    assert here.returncode == 69
    assert "my-stage: no rig of that name runs here" in here.stderr
    assert "hil run FILE" in here.stderr
    (tmp_path / "my-stage.toml").write_text("")
    here = hil_here(verb, "my-stage", *rest)
    assert "hil run my-stage.toml, and beside it hil sidecar my-stage.toml" in here.stderr


def test_events_of_a_rig_that_never_ran_say_so(hil_here: CommandLine) -> None:
    here = hil_here("events", "my-stage")
    assert here.returncode == 69
    assert "my-stage: no rig of that name runs here" in here.stderr
