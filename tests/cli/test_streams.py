"""Standard streams that are closed or full: nothing else gets their numbers, and what is not written is told."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.base.named_file import naming
from hil.cli.exit_status import EXIT_FILE
from tests.support.paths import ROOT

EXPLAIN = f"'{sys.executable}' -m hil explain safety"


def shell(line: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["sh", "-c", line], cwd=ROOT, capture_output=True, text=True, check=False)


def test_a_full_output_is_told_in_one_line_and_by_the_status() -> None:
    done = shell(f"{EXPLAIN} > /dev/full")
    assert (done.returncode, done.stderr) == (EXIT_FILE, "hil: standard output: No space left on device\n")


@pytest.mark.parametrize("key", ["plant", "plant.mass"])
def test_who_reads_may_leave_early_as_head_does(key: str) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "hil", "explain", key], cwd=ROOT, stdout=writing, stderr=subprocess.PIPE, check=False
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (1, b"")


def test_closed_streams_become_dev_null_before_a_file_gets_their_numbers(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(
        "import os, sys\n"
        "from hil.cli.streams import open_standard_streams\n"
        "open_standard_streams()\n"
        "print('to nobody')\n"
        "print('nor here', file=sys.stderr)\n"
        "places = [os.readlink(f'/proc/self/fd/{number}') for number in range(3)]\n"
        "open(sys.argv[1], 'w').write(' '.join(places))\n"
    )
    done = shell(f"PYTHONPATH='{ROOT}' '{sys.executable}' '{program}' '{tmp_path}/told' <&- >&- 2>&-")
    assert done.returncode == 0
    assert (tmp_path / "told").read_text() == "/dev/null /dev/null /dev/null"


def test_a_command_works_with_its_input_and_errors_closed() -> None:
    done = shell(f"{EXPLAIN} <&- 2>&-")
    assert done.returncode == 0
    assert "stop_s" in done.stdout


def test_an_error_without_a_name_gets_that_of_the_file() -> None:
    with pytest.raises(OSError, match="No space left") as caught, naming(Path("/dev/full")):
        Path("/dev/full").write_text("x")
    assert caught.value.filename == "/dev/full"


def test_an_error_that_has_a_name_keeps_it() -> None:
    with pytest.raises(FileNotFoundError) as caught, naming("other"):
        Path("/none/x").read_text()
    assert caught.value.filename == "/none/x"
