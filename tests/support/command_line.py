"""`hil WORDS` in this process: the same entry point and the same texts, without half a second of imports."""

import sys
from typing import NamedTuple, Protocol

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


def command_line(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> CommandLine:
    """Of a test that captures what is written."""

    def hil(*words: str) -> Said:
        capsys.readouterr()
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["hil", *words])
            with pytest.raises(SystemExit) as ended:
                main()
        assert isinstance(ended.value.code, int | None), "a text is for the interpreter to print"
        return Said(ended.value.code or 0, *capsys.readouterr())

    return hil
