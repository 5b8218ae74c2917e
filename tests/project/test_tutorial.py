"""The tutorial runs, word by word, in the order of the page."""

import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.paths import ROOT

PAGE = (ROOT / "docs" / "tutorial.md").read_text()
BLOCK = re.compile(r"^```(\w+)(?: title=\"([\w.-]+)\")?\n(.*?)^```", re.MULTILINE | re.DOTALL)
STAY_MICROMETRES = (5, 8, 14)  # what step 4 says of the shipped law


def blocks() -> Iterator[tuple[str, str, str]]:
    """(language, title, text) of every fenced block."""
    yield from (match.groups(default="") for match in BLOCK.finditer(PAGE))  # type: ignore[misc]


def test_every_block_is_a_command_or_a_file() -> None:
    assert {(language, bool(title)) for language, title, _ in blocks()} == {("sh", False), ("python", True)}


@pytest.mark.live
def test_the_tutorial_runs_from_the_first_command_to_the_last(tmp_path: Path) -> None:
    runtime = {"HIL_RUNTIME_DIR": str(tmp_path / "runtime"), "HOME": str(tmp_path)}
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    printed = ""
    for language, title, text in blocks():
        if language == "python":
            (tmp_path / title).write_text(text)
            continue
        for line in text.splitlines():
            done = subprocess.run(
                ["sh", "-c", line],
                cwd=tmp_path,
                env={**os.environ, **runtime, "PATH": path, "COLUMNS": "160"},
                capture_output=True,
                text=True,
                check=False,
                timeout=400,
            )
            assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
            assert "Traceback" not in done.stderr
            printed += done.stdout
    assert "accepted" in printed
    before, after = (ast.literal_eval(found) for found in re.findall(r"mcap (\{.*\}) um", printed))
    assert tuple(round(value) for value in before.values()) == STAY_MICROMETRES
    assert max(after.values()) < 0.1
    assert (tmp_path / "learnt.html").stat().st_size > 10_000
