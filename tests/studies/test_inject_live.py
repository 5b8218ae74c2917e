"""`hil inject --live`: real processes, the same verdicts as in virtual time, and an operator at a second terminal."""

import csv
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader

from hil.runs.api import load_run
from hil.telemetry import telemetry_pb2 as pb
from tests.support.paths import RIGS

# An ideal stage forgives a host that stalls for some milliseconds; guides do not.
RIG = str(RIGS / "microscope-ideal.toml")
WHILE_S = 120.0
pytestmark = [pytest.mark.live, pytest.mark.slow]


def hil(*words: str) -> list[str]:
    return [sys.executable, "-m", "hil", "inject", RIG, *words]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for what it leaves, and a runtime directory of this test's own."""
    runtime = tmp_path / "runtime"
    runtime.mkdir(mode=0o700)
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(runtime))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def verdicts(path: Path) -> list[str]:
    with path.open(newline="") as file:
        return [row["verdict"] for row in csv.DictReader(file)]


def tell(word: str) -> None:
    """From a second terminal; again where this computer has just stopped the rig."""
    end = time.monotonic() + WHILE_S
    command = [sys.executable, "-m", "hil", "inject", "microscope-ideal", "--tell", word]
    while (done := subprocess.run(command, capture_output=True, text=True, check=False)).returncode:
        assert time.monotonic() < end, done.stderr
    assert done.stdout == f"{word}: taken\n"


def until(there: Callable[[], bool], running: subprocess.Popen[str]) -> None:
    end = time.monotonic() + WHILE_S
    while not there():
        assert running.poll() is None, running.communicate()[0]
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_live_batch_has_the_verdicts_of_virtual_time_and_records_its_cells(here: Path) -> None:
    words = ("--grid", "1x3", "--anomalies", "0.5", "--seed", "6", "--ask", "skip@2:approach")
    virtual, live = here / "virtual.csv", here / "live.csv"
    subprocess.run(hil(*words, "--csv", str(virtual)), check=True, capture_output=True, timeout=WHILE_S)
    done = subprocess.run(
        hil(*words, "--live", "--csv", str(live), "--report", "page.html"), capture_output=True, text=True,
        timeout=WHILE_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    wanted = verdicts(virtual)
    assert wanted[1] == "skipped"
    stops = re.search(r"(\d+) stop\(s\) because this computer was too busy", done.stdout)
    cut = verdicts(live).count("unknown")  # a cell in which this computer held the rig up has no verdict
    assert cut <= (int(stops[1]) if stops else 0)
    assert [a for a, b in zip(verdicts(live), wanted, strict=True) if a not in (b, "unknown")] == []
    assert (here / "page.html").read_text().count("<polyline") >= 2 - cut
    (recording,) = here.glob("runs/*/run.mcap")
    with recording.open("rb") as file:
        told = [pb.Cell.FromString(m.data) for _, _, m in make_reader(file).iter_messages(topics=["cells"])]
    assert [cell.verdict for cell in told if cell.verdict] == verdicts(live)


def test_a_second_terminal_pauses_and_aborts_a_batch(here: Path) -> None:
    target = here / "cells.csv"
    words = ("--grid", "5x5", "--csv", str(target), "--live")
    running = subprocess.Popen(hil(*words), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        until(lambda: target.exists() and len(verdicts(target)) >= 1, running)
        tell("pause")
        time.sleep(1.0)
        paused = target.read_text()
        time.sleep(1.5)  # longer than a cell takes
        assert target.read_text() == paused
        tell("abort")  # from the pause, which lasts however long the other terminal takes to start
        said = running.communicate(timeout=WHILE_S)[0]
    finally:
        if running.poll() is None:
            running.terminate()
            running.wait(timeout=WHILE_S)
    assert running.returncode == 1
    assert "it was ended before" in said
    assert "--resume" in said
    before = verdicts(target)
    assert "none" not in before
    assert 0 < len(before) < 25


def test_a_rig_that_does_not_run_cannot_be_asked(here: Path) -> None:
    assert os.environ["HIL_RUNTIME_DIR"].startswith(str(here))
    done = subprocess.run(hil("--tell", "skip"), capture_output=True, text=True, timeout=WHILE_S, check=False)
    assert done.returncode == 69
    assert "does not run here" in done.stderr


def test_a_disk_that_fills_up_ends_a_live_batch_outside_the_cell_and_says_how_to_go_on(here: Path) -> None:
    """One page of a file system is the CSV file's: it is full after some cells."""
    small = here / "small"
    small.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=4k", "tmpfs", str(small)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("needs root: only root may mount the small tmpfs that is to be full")
    try:
        target = small / "cells.csv"
        words = ("--grid", "4x6", "--live", "--csv", str(target))
        done = subprocess.run(hil(*words), capture_output=True, text=True, timeout=2 * WHILE_S, check=False)
        said = done.stdout + done.stderr
        assert done.returncode == 1, said
        assert f"{target}: No space left on device" in said
        assert "Traceback" not in said
        assert "--resume" in said
        cells = verdicts(target)
        assert 1 <= len([verdict for verdict in cells if verdict]) < 24
    finally:
        subprocess.run(["umount", str(small)], check=True)
    (recording,) = here.glob("runs/*/run.mcap")
    with recording.open("rb") as file:
        told = [pb.Cell.FromString(m.data) for _, _, m in make_reader(file).iter_messages(topics=["cells"])]
    over = [cell.verdict for cell in told if cell.verdict]
    assert len(over) >= len(cells) - 1, "the recording has what the file has not"
    if not told[-1].verdict:  # it was about to begin one: its row is written first
        assert told[-1].phase == "tare"
        assert cells[-1] in ("", "none")  # as far as the row went in
    run = load_run(recording)
    safe = run.rig.motion.parameters["safe"]
    assert run.measured[-1, run.axes.index("z")] > safe - 1e-5, "the tip has left the last cell"
