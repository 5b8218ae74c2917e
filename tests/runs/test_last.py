"""Where no run is named, the newest of this folder is meant, and said."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hil.runs.last import last_runs


def made(folder: Path, *names: str) -> None:
    """Folders of runs, each a second younger than the one before; the last has no recording."""
    for age, name in enumerate(names):
        (folder / name).mkdir(parents=True)
        (folder / name / "run.mcap").touch()
        os.utime(folder / name / "run.mcap", (age, age))
    (folder / "zz-cut").mkdir(parents=True)


def test_the_newest_recording_counts_not_the_name(tmp_path: Path) -> None:
    made(tmp_path, "b", "c", "a")
    assert [path.name for path in last_runs(2, tmp_path)] == ["c", "a"]


@pytest.mark.parametrize(("names", "few"), [((), "no run here"), (("a",), "only one run here")])
def test_too_few_are_refused_with_what_to_do(tmp_path: Path, names: tuple[str, ...], few: str) -> None:
    made(tmp_path, *names)
    with pytest.raises(FileNotFoundError, match=f"{few}; name a recording, or make one: hil demo"):
        last_runs(2, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("command", ["plot", "report", "export", "diff", "events"])
def test_a_command_without_a_run_says_what_is_missing_in_one_line(tmp_path: Path, command: str) -> None:
    words = [sys.executable, "-m", "hil", command]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 74
    assert done.stderr == "hil: runs/: no run here; name a recording, or make one: hil demo\n"
