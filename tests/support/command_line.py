"""`hil WORDS` in this process: the same entry point and the same texts, without half a second of imports."""

import sys
from typing import NamedTuple, Protocol
from unittest.mock import patch

import pytest

from hil.__main__ import main


class Said(NamedTuple):
    """What subprocess.run would have returned of it."""

    returncode: int
    stdout: str
    stderr: str


class CommandLine(Protocol):
    """Runs `hil WORDS` to its end."""

    def __call__(self, *words: str) -> Said:
        """What it said, and its exit status."""


def exit_status(*words: str) -> int:
    """Of `hil WORDS`, run to its end here. What it writes goes where sys.stdout and sys.stderr lead."""
    with patch.object(sys, "argv", ["hil", *words]), pytest.raises(SystemExit) as ended:
        main()
    assert isinstance(ended.value.code, int | None), "a text is for the interpreter to print"
    return ended.value.code or 0


def command_line(capsys: pytest.CaptureFixture[str]) -> CommandLine:
    """Of a test that captures what is written."""

    def hil(*words: str) -> Said:
        capsys.readouterr()
        return Said(exit_status(*words), *capsys.readouterr())

    return hil
