"""Stop, a thousand times; a few in the ordinary lane."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.live_rig import PAPER
from tests.support.paths import ROOT

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(os.geteuid() != 0, reason="makes a file system and a network of its own, to break them"),
]


def pressed(count: int, directory: Path) -> str:
    for part in PAPER.parent.iterdir():
        if part.is_file():
            (directory / part.name).write_bytes(part.read_bytes())
    mount = directory / "runtime"
    mount.mkdir()
    script = f'ip link set lo up && mount -t tmpfs -o size=64m,mode=700 none {mount} && exec "$@"'
    line = [sys.executable, "-m", "tests.attacks.presses", str(count), str(directory / "paper.toml")]
    environment = {**os.environ, "HIL_RUNTIME_DIR": str(mount)}
    done = subprocess.run(
        ["unshare", "-m", "-n", "sh", "-c", script, "sh", *line],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_a_few_presses_with_everything_around_broken_in_turn(tmp_path: Path) -> None:
    assert pressed(7, tmp_path).count("none missed") == 7


@pytest.mark.slow
def test_a_thousand_presses_with_everything_around_broken_in_turn(tmp_path: Path) -> None:
    assert pressed(1000, tmp_path).count("none missed") == 7
