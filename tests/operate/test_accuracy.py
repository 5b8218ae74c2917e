"""`hil accuracy`: the cycle of ISO 230-2 on emulated stages, whose true positions are known."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hil
from hil.cli.app import build_app
from hil.operate.accuracy import _settled, approaches


def run(*words: str) -> tuple[int, str]:
    done = CliRunner(env={"COLUMNS": "200"}).invoke(build_app("accuracy"), ["accuracy", *words])
    return done.exit_code, done.output


@pytest.mark.long
def test_every_target_is_approached_from_both_sides_and_measured_twice() -> None:
    mover = hil.motion(hil.load_rig("microscope-ideal"))
    low, high = mover.range_of("x")
    with mover:
        found = approaches(mover, "x", 5, 2)
    assert (found.up.shape, found.true_down.shape, found.settled_s.shape) == ((5, 2), (5, 2), (20,))
    assert low < found.targets[0] < found.targets[-1] < high
    columns = mover.run().columns
    order = np.diff(columns["setpoint_position"][:, 0])
    assert (order > 0.0).any()
    assert (order < 0.0).any()
    assert np.abs(found.up - found.true_up).max() < 1e-8, "an ideal encoder shows the truth to a count"
    assert np.abs(found.up).max() < 3e-6


@pytest.mark.slow
def test_backlash_of_the_stage_shows_as_its_reversal() -> None:
    figures = {}
    for name, play in (("stiff", 0.0), ("loose", 2e-5)):
        rig = hil.load_rig("microscope-ideal", [f"plant.backlash={play}"])
        with hil.motion(rig) as mover:
            found = approaches(mover, "x", 5, 2)
        figures[name] = np.abs((found.true_up - found.true_down).mean(axis=1)).max()
    assert figures["loose"] == pytest.approx(2e-5, rel=0.1)
    assert figures["stiff"] < 5e-6


@pytest.mark.long
def test_the_command_prints_and_writes_the_figures(tmp_path: Path) -> None:
    target = tmp_path / "found.json"
    words = ["--axes", "y", "--runs", "2", "--json", str(target)]
    code, output = run("microscope-ideal", *words)
    assert code == 0, output
    for word in ("accuracy A", "reversal B", "y, true", "5 targets, 2 runs", "ms"):
        assert word in output
    axis = json.loads(target.read_text())["axes"]["y"]
    assert np.shape(axis["encoder"]["up"]) == (5, 2)
    assert axis["encoder"]["accuracy"] > 0.0
    assert axis["true"]["reversal"] == pytest.approx(axis["encoder"]["reversal"], abs=2e-6)


def test_what_never_came_into_position_is_said() -> None:
    assert _settled(np.array([0.01, 0.03, 0.02])) == "20 / 30 ms"
    assert _settled(np.array([0.01, np.nan, 0.02])) == "15 / 20 ms, 1 never"
    assert _settled(np.array([np.nan, np.nan])) == "never"


def test_what_it_cannot_do_is_refused() -> None:
    assert "the axes are x, y" in run("paper", "--axes", "w")[1]
    assert "a running rig is as it is" in run("paper", "--live", "--set", "rate_hz=500")[1]
    code, output = run("paper", "--live")
    assert code == 69
    assert "does not run here" in output
