"""The command line a person reads: grouped, plain, one spelling."""

import re
import subprocess
import sys

import pytest
import typer

from hil.cli.app import COMMANDS, build_app, run
from hil.cli.help_text import present_spelling
from tests.support.command_line import CommandLine

NAMES = [name for group in COMMANDS.values() for name in group if name != "run"]  # run parses its own arguments


@pytest.mark.parametrize("name", NAMES)
def test_help_loses_nothing_in_a_narrow_terminal(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    app = build_app(name)
    command = typer.main.get_command(app).commands[name]  # type: ignore[attr-defined]
    written = {bracket for one in command.params for bracket in re.findall(r"\[[a-z_.]+\]", one.help or "")}
    shown = [one for one in command.params if not getattr(one, "hidden", False)]
    options = {word for one in shown for word in one.opts if word.startswith("--")}
    monkeypatch.setattr(sys, "argv", ["hil", name, "--help"])
    monkeypatch.setenv("COLUMNS", "60")
    with pytest.raises(SystemExit) as ended:
        run(app)
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert {option for option in options if not re.search(rf"^  .*{option}\b", text, re.MULTILINE)} == set()
    assert {bracket for bracket in written if bracket not in re.sub(r"\s", "", text)} == set()
    assert not re.search(r"…|[{}]|\[\[", text)
    assert "..." not in text.partition("\nCommands:\n")[2]


def test_the_first_screen_says_what_hil_is_and_has_every_command_in_a_group() -> None:
    text = subprocess.run([sys.executable, "-m", "hil", "--help"], capture_output=True, text=True, check=True).stdout
    assert "controls a cell-injection stage" in text
    assert [group for group in COMMANDS if f"\n{group}:\n" not in text] == []
    assert [name for group in COMMANDS.values() for name in group if f"\n  {name} " not in text] == []


def test_without_a_word_the_first_screen_is_shown(hil_here: CommandLine) -> None:
    asked = hil_here()
    assert asked.returncode == 2
    assert asked.stdout == hil_here("--help").stdout


def test_help_of_a_command_says_what_its_exit_statuses_mean(hil_here: CommandLine) -> None:
    text = hil_here("sim", "--help").stdout
    assert "Run a rig in virtual time: the same result every time.\n" in text
    assert "Exit status 3: the run ended in a fault." in text


def test_types_are_words(hil_here: CommandLine) -> None:
    text = hil_here("sweep", "--help").stdout
    assert "NUMBER from 1 to" in text
    assert not re.search(r"<(int|float|str|path|bool|list)", text)


def test_a_former_spelling_is_taken_once_more_and_said() -> None:
    words, told = present_spelling(["sweep", "paper", "--output=x", "--jobs", "2", "--", "--jobs"])
    assert words == ["sweep", "paper", "--out=x", "--workers", "2", "--", "--jobs"]
    assert [line.split(";")[0] for line in told] == ["--output is now --out", "--jobs is now --workers"]


@pytest.mark.parametrize(
    ("words", "taken"),
    [
        (["sim", "paper", "--json"], ["sim", "paper", "--json", "-"]),
        (["sim", "--json", "--seconds", "1", "paper"], ["sim", "--json", "-", "--seconds", "1", "paper"]),
        (["sim", "paper", "--json", "-"], ["sim", "paper", "--json", "-"]),
        (["sim", "paper", "--json", "x.json"], ["sim", "paper", "--json", "x.json"]),
        (["events", "--json", "paper"], ["events", "--json", "paper"]),
        (["doctor", "--json"], ["doctor", "--json"]),
    ],
)
def test_json_without_a_file_is_standard_output(words: list[str], taken: list[str]) -> None:
    assert present_spelling(words) == (taken, [])


def test_a_misspelt_name_gets_the_nearest_one(hil_here: CommandLine) -> None:
    assert "Did you mean 'check'?" in hil_here("chek", "paper").stderr
    assert hil_here("check", "microscop").stderr == "hil: microscop: no such file; did you mean microscope?\n"


def test_rigs_lists_what_can_stand_for_a_rig(hil_here: CommandLine) -> None:
    text = hil_here("rigs").stdout
    assert re.search(r"^microscope +x y z theta +1000 Hz +stage_fd +presliding-kalman", text, re.MULTILINE)
