"""The programs of docs/programs.md run as they stand there, in a folder that holds nothing else."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.paths import ROOT

BLOCK = re.compile(r"^```python title=\"([\w.-]+)\"\n(.*?)^```", re.MULTILINE | re.DOTALL)
PROGRAMS = dict(BLOCK.findall((ROOT / "docs" / "programs.md").read_text(encoding="utf-8")))
SAID = {
    "study.py": r"(?s)0\.5 .*2\.0 \{'x': '[\d.]+ um', 'y': '[\d.]+ um'\}",
    "integral.py": r"0\.0 ACTIVE [\d.]+ um\n20\.0 ACTIVE [\d.]+ um",
    "two.py": r"x \{'setpoint': '[\d.e-]+', 'error': '[\d.e-]+', 'force': ",
    "spiral.py": r"<Simulation of paper, pd-feedforward: 5\.999 s, ended ACTIVE>",
    "spectrum.py": r"(?s)x: [\d.]+ Hz.*theta: [\d.]+ Hz",
}


def test_every_program_of_the_page_is_tried() -> None:
    assert PROGRAMS.keys() == SAID.keys()


@pytest.mark.long
@pytest.mark.parametrize("name", SAID)
def test_a_program_runs_in_an_empty_folder_first_time(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(PROGRAMS[name], encoding="utf-8")
    done = subprocess.run(
        [sys.executable, name], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert re.search(SAID[name], done.stdout), done.stdout
