"""What a command costs before it does anything: CPU time against that of loading numpy, by turns."""

import os
import statistics
import subprocess
import sys

import pytest

TURNS = 11
MOST = 1.4  # times numpy
NUMPY = ["-c", "import numpy"]


def cpu_s(*words: str) -> float:
    """CPU time of a Python program, s: its own and the kernel's for it."""
    with subprocess.Popen([sys.executable, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, words
    return usage.ru_utime + usage.ru_stime


@pytest.mark.long
@pytest.mark.parametrize("words", [["--version"], ["--help"], ["explain", "law.name"]], ids=" ".join)
def test_to_start_costs_about_as_much_as_to_load_numpy(words: list[str]) -> None:
    ratios = [cpu_s("-m", "hil", *words) / cpu_s(*NUMPY) for _ in range(TURNS)]
    assert statistics.median(ratios) < MOST, [round(ratio, 2) for ratio in ratios]
