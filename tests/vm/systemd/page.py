"""docs/at-the-rig.md, followed: every command on the page is run, in the page's order."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from tests.vm.systemd.service import console, eventually, sh, watch

PAGE = Path("/share/docs/at-the-rig.md")
followed: list[str] = []  # sections, by number


class CtrlC(NamedTuple):
    """A command that only Ctrl-C ends, pressed when it has shown `until`."""

    until: str
    meanwhile: Callable[[], object] = lambda: None


Check = Callable[[str], object] | CtrlC  # gets the output


def sections() -> dict[str, str]:
    """Number -> text of the numbered sections."""
    _, *parts = re.split(r"^## (\d+)\. .*$", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return dict(zip(parts[::2], parts[1::2], strict=True))


def commands(section: str) -> list[str]:
    """The section's commands in order, without the remarks behind them."""
    lines = [line[4:] for line in sections()[section].splitlines() if line.startswith("    ")]
    found = []
    while lines:
        command = re.sub(r"\s+#.*", "", lines.pop(0)).rstrip()
        if here := re.search(r"<<'(\w+)'", command):
            end = lines.index(here[1])
            command = "\n".join([command, *lines[: end + 1]])
            del lines[: end + 1]
        found.append(command)
    return found


def follow(section: str, words: dict[str, str], checks: dict[str, Check]) -> None:
    """Run the section's commands, with the reader's own words for the page's, and check after each what came of it.

    checks: every command of the section, in order, by how it begins; a page that says something else is a failure.
    """
    on_page = commands(section)
    assert len(on_page) == len(checks), f"section {section}: {on_page}"
    for command, (beginning, check) in zip(on_page, checks.items(), strict=True):
        assert command.startswith(beginning), f"section {section} says {command!r}, expected {beginning!r}"
        for word, own in words.items():
            command = command.replace(word, own)
        print(f"$ {command}")
        if isinstance(check, CtrlC):
            watch(command, check.until, check.meanwhile)
        else:
            check(insist(command) if command.startswith("hil command") else sh(command, ok="status" not in command))
    followed.append(section)


# What makes a command possible again where the rig has gone to FAULT meanwhile.
BEFORE = {"activate": ["reset"], "stop": ["reset", "activate"]}


def insist(command: str) -> str:
    """An operator's command, again until it is taken: a guest that is not let run for a while takes none in time."""
    told: list[str] = []
    line, action = command.rsplit(" ", 1)

    def taken() -> bool:
        told.append(sh(f"{command} || echo refused", ok=False))
        if "refused" not in told[-1]:
            return True
        for step in BEFORE.get(action, []):
            console(f"{line.removeprefix('hil ')} {step}")
        return False

    eventually(taken, command)
    return told[-1]


def says(*words: str) -> Callable[[str], None]:
    """A check that the output contains each of the words."""

    def check(output: str) -> None:
        for word in words:
            assert word in output, f"{word!r} is not in:\n{output}"

    return check


def nothing(output: str) -> None:
    """A check that there is no output."""
    assert output == ""


def whatever(output: str) -> None:
    """A command whose exit status says all."""
