"""Worker processes end with the command that started them, however that ends."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support.paths import ROOT

PAPER = str(ROOT / "deploy" / "rigs" / "paper.toml")
PATIENCE_S = 30.0


def runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.mark.long
@pytest.mark.parametrize("lead_s", [0.0, 1.0], ids=["just started", "at work"])
@pytest.mark.parametrize(
    "words",
    [
        ["sweep", PAPER, "--plants", "20000", "--seconds", "1000", "--workers", "2"],
        ["compare", PAPER, "--seconds", "1000", "--workers", "2"],
        ["faults", PAPER, "--workers", "2"],
        ["reproduce", "--workers", "2"],
    ],
    ids=lambda words: words[0],
)
def test_no_worker_outlives_a_command_that_was_killed(tmp_path: Path, words: list[str], lead_s: float) -> None:
    command = subprocess.Popen(
        [sys.executable, "-m", "hil", *words], cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    until = time.monotonic() + PATIENCE_S
    while len(children(command.pid)) < 2:
        assert time.monotonic() < until
        time.sleep(0.01)
    time.sleep(lead_s)
    workers = children(command.pid)
    command.kill()
    command.wait()
    until = time.monotonic() + PATIENCE_S
    try:
        while any(map(runs, workers)):
            assert time.monotonic() < until, workers
            time.sleep(0.02)
    finally:
        for worker in filter(runs, workers):
            os.kill(worker, signal.SIGKILL)


def test_a_worker_whose_parent_died_before_it_could_ask_to_be_told_ends_by_itself() -> None:
    never = 0  # no parent has this id
    code = f"from hil.cli.processes import die_with_parent; die_with_parent({never}); print('orphaned')"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout) == (1, "")
