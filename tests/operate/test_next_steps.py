"""The commands that a demo ends with can be pasted, however it was started."""

import shlex
import subprocess
from pathlib import Path

import pytest

from hil.operate.demo import this_command
from tests.support.paths import ROOT


def test_a_module_that_was_run_by_python_is_named_as_it_was_run() -> None:
    words = shlex.split(this_command(str(ROOT / "hil" / "__main__.py")))
    done = subprocess.run([*words, "--version"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()[0]) == (0, "hil")


@pytest.mark.parametrize("place", ["/opt/hil/bin/hil", "/home/a b/bin/hil"])
def test_a_script_is_named_by_its_place(place: str) -> None:
    assert shlex.split(this_command(place)) == [str(Path(place))]
