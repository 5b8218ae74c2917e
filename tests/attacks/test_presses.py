"""Stop, a thousand times; a few in the ordinary lane."""

import os
from pathlib import Path

import pytest

from tests.attacks.presses import isolated

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(os.geteuid() != 0, reason="makes a file system and a network of its own, to break them"),
]


@pytest.mark.requirement(id="SR-2.1")
def test_a_few_presses_with_everything_around_broken_in_turn(tmp_path: Path) -> None:
    done = isolated(7, tmp_path)
    assert (done.returncode, done.stdout.count("none missed")) == (0, 7), done.stdout
    assert "ran: 7 presses, 0 missed" in done.stdout


@pytest.mark.requirement(id="SR-2.1")
@pytest.mark.slow
def test_a_thousand_presses_with_everything_around_broken_in_turn(tmp_path: Path) -> None:
    done = isolated(1000, tmp_path)
    print(done.stdout)
    assert (done.returncode, done.stdout.count("none missed")) == (0, 7), done.stdout
