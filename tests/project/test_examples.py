"""Every example runs, by itself, in an empty folder; the notebooks cell by cell."""

import base64
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from docs.notebooks import outputs_of
from hil.live.runtime_paths import runtime_paths
from tests.support.live_rig import PAPER, Control, emulated
from tests.support.paths import ROOT

FOLDER = ROOT / "examples"
PROGRAMS = sorted(path.name for path in FOLDER.glob("[0-9]*.py"))
LIVE = [name for name in PROGRAMS if "live" in name]
NOTEBOOKS = sorted(path.name for path in FOLDER.glob("*.ipynb"))
PATIENCE_S = 300.0
SAID = {
    "01_simulate_and_plot.py": "nm RMS",
    "06_your_own_task.py": "as it should be",
    "08_faults_on_your_law.py": "state FAULT",
    "09_read_a_recording.py": "0 ticks differ",
    "14_your_own_estimator.py": "as it should be: FAULT, estimator",
    "16_your_own_motion.py": "felt at -2",
    "17_your_own_sensor.py": "felt 0.20 mN at most; noise at rest 4.9 uN",
    "15_move_a_rig.py": "in position: x 0.1000",
}


def ran(words: list[str], folder: Path) -> str:
    environment = {**os.environ, "MPLBACKEND": "Agg"}
    command = [sys.executable, *words]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def code_of(notebook: Path) -> str:
    """The cells of a notebook as one program; the last expression of a cell is only looked at."""
    document = json.loads(notebook.read_text())
    assert (document["nbformat"], document["nbformat_minor"]) == (4, 5)
    cells = [cell for cell in document["cells"] if cell["cell_type"] == "code"]
    return "\n\n".join("".join(cell["source"]) for cell in cells)


def told(outputs: list[list[dict[str, Any]]]) -> list[list[str]]:
    """The text of each cell, "picture" for one: a picture's bytes are its fonts' and libraries' affair."""
    return [
        ["".join(one.get("text", one.get("data", {}).get("text/plain", "picture"))) for one in cell] for cell in outputs
    ]


def test_the_ladder_names_every_example_and_no_other() -> None:
    named = set(re.findall(r"\]\((\w+\.(?:py|ipynb))\)", (FOLDER / "README.md").read_text()))
    assert named == {*PROGRAMS, *NOTEBOOKS}
    assert len(PROGRAMS) >= 12
    assert len(NOTEBOOKS) >= 3
    for name in NOTEBOOKS:
        compile(code_of(FOLDER / name), name, "exec")


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in PROGRAMS if name not in LIVE])
def test_a_program_runs_in_an_empty_folder(name: str, tmp_path: Path) -> None:
    assert SAID.get(name, "") in ran([str(FOLDER / name)], tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_shows_what_its_cells_print_and_draw(name: str) -> None:
    document = json.loads((FOLDER / name).read_text())
    stored = [cell["outputs"] for cell in document["cells"] if cell["cell_type"] == "code"]
    assert told(outputs_of(document)) == told(stored), "python -m docs.notebooks"


def test_every_notebook_is_stored_with_a_picture_and_without_an_error() -> None:
    for name in NOTEBOOKS:
        cells = json.loads((FOLDER / name).read_text())["cells"]
        shown = [output for cell in cells if cell["cell_type"] == "code" for output in cell["outputs"]]
        assert {output["output_type"] for output in shown} <= {"stream", "execute_result", "display_data"}, name
        pictures = [output["data"]["image/png"] for output in shown if output["output_type"] == "display_data"]
        assert pictures, f"{name}: python -m docs.notebooks"
        assert all(base64.b64decode(picture).startswith(b"\x89PNG") for picture in pictures)


@pytest.mark.slow
@pytest.mark.live
def test_a_live_rig_is_commanded_and_watched_by_the_examples(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "hil", "sidecar", str(PAPER), "--listen", "tcp/127.0.0.1:7447", "--or-free-port"]
    with emulated(), Control():
        sidecar = subprocess.Popen([*words, "--out", str(tmp_path)], cwd=ROOT, stdout=subprocess.DEVNULL)
        try:
            until = time.monotonic() + 30.0
            while not runtime_paths("paper").endpoint.exists() and time.monotonic() < until:
                time.sleep(0.02)
            assert "it is READY" in ran([str(FOLDER / "11_command_a_live_rig.py"), "paper"], tmp_path)
            assert "force [" in ran([str(FOLDER / "10_watch_a_live_rig.py"), "paper"], tmp_path)
        finally:
            sidecar.terminate()
            sidecar.wait(20.0)
