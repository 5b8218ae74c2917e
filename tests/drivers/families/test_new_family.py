"""A family is its folder: one that no other file knows is found, written about, checked, run, and faulted."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.new_family import write_family
from tests.support.paths import ROOT

PROGRAM = """
import sys
import drivers.families
drivers.families.__path__.append(sys.argv.pop(1))
"""
COMMAND = PROGRAM + "from hil.__main__ import main\nmain()"
CELLS = (
    PROGRAM
    + """
from pathlib import Path
from hil.rig.file import load_rig
from hil.studies.fault_campaign.matrix import plan_chunks, run_chunk
file = Path(sys.argv[1])
chunks = plan_chunks(load_rig(file), file.parent, only="axis jammed")
cells = [cell for chunk in chunks[-2:] for cell in run_chunk(chunk)]
assert cells
print([(cell.trial, cell.why) for cell in cells if not cell.passed])
"""
)


def run(program: str, *arguments: object) -> str:
    command = [sys.executable, "-c", program, *map(str, arguments)]
    where = Path(str(arguments[0]))  # pictures go to the working directory
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=where, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_family(tmp_path_factory.mktemp("families"))


@pytest.fixture(scope="module")
def rig(place: Path) -> Path:
    file = place / "boxes.toml"
    assert "written" in run(COMMAND, place, "new", file, "--layout", "torquebox", "--axes", "x,y")
    assert 'protocol = "torquebox"' in file.read_text()
    return file


@pytest.mark.long
def test_a_rig_of_it_is_written_checked_and_run(place: Path, rig: Path) -> None:
    assert "torque 0" in run(COMMAND, place, "check", rig)
    said = run(COMMAND, place, "sim", rig, "--seconds", "1")
    assert "rms" in said.lower()


@pytest.mark.long
def test_the_fault_campaign_plays_its_cells(place: Path, rig: Path) -> None:
    assert run(CELLS, place, rig).strip() == "[]"
