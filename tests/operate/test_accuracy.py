"""`hil accuracy`: the cycle of ISO 230-2 on emulated stages, whose true positions are known."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hil
from hil.cli.app import build_app
from hil.operate.accuracy import _settled, approaches
from hil.operate.approach_file import read_reference
from hil.rig.schema import RigError


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


@pytest.mark.long
def test_what_an_instrument_read_at_the_stops_gives_figures_of_its_own(tmp_path: Path) -> None:
    made, picture, read = tmp_path / "made.csv", tmp_path / "made.png", tmp_path / "read.csv"
    code, output = run("microscope-ideal", "--axes", "y", "--runs", "2", "--out", str(made), "--picture", str(picture))
    assert code == 0, output
    assert picture.read_bytes().startswith(b"\x89PNG")
    rows = list(csv.DictReader(made.open()))
    assert [row["direction"] for row in rows] == (["up"] * 5 + ["down"] * 5) * 2
    targets = [float(row["target"]) for row in rows]
    assert targets[:5] == sorted(targets[:5]) == targets[9:4:-1]
    stretched = [{**row, "reference": str(3.0 + 1.001 * float(row["target"]))} for row in rows]
    assert figures_of(read, stretched)["accuracy"] == pytest.approx(0.001 * (targets[4] - targets[0]))
    assert figures_of(read, stretched[::-1]) == figures_of(read, stretched), "rows may stand in any order"


def figures_of(path: Path, rows: list[dict[str, str]]) -> dict[str, float]:
    with path.open("w") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    code, output = run("microscope-ideal", "--reference", str(path), "--json", "-")
    assert code == 0, output
    return json.loads(output[output.index("{") :])["axes"]["y"]["reference"]


def read_rows(**changed: str) -> list[dict[str, str]]:
    """Two targets, two runs, both directions; the last row is changed."""
    rows = [
        {"axis": "x", "run": run, "direction": side, "target": place, "reference": place}
        for run in "12" for side in ("up", "down") for place in ("0.0", "0.001")
    ]  # fmt: skip
    return [*rows[:-1], {**rows[-1], **changed}]


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"axis": "w"}, "line 9: axis = 'w': one of x, y"),
        ({"direction": "left"}, "line 9: direction = 'left': one of up, down"),
        ({"reference": "nan"}, "line 9: reference = 'nan' is not a finite number"),
        ({"run": ""}, "line 9: run = '' is not a finite number"),
        ({"target": "0.0"}, "line 9: axis x, target 0, down, run 2 stands there twice"),
        ({"run": "3"}, "axis x: target 0, up, run 3 is missing"),
    ],
)
def test_a_file_that_is_not_whole_is_refused_by_line_and_value(
    tmp_path: Path, changed: dict[str, str], said: str
) -> None:
    path = tmp_path / "read.csv"
    with path.open("w") as file:
        table = csv.DictWriter(file, list(read_rows()[0]))
        table.writeheader()
        table.writerows(read_rows(**changed))
    with pytest.raises(RigError) as refused:
        read_reference(path, ["x", "y"])
    assert said in refused.value.problems[0]


def test_a_file_without_readings_is_told_what_it_lacks(tmp_path: Path) -> None:
    path = tmp_path / "read.csv"
    path.write_text("axis,run,direction,target,encoder\nx,1,up,0.0,0.0\n")
    with pytest.raises(RigError, match="there is no column reference"):
        read_reference(path, ["x"])
    path.write_text("axis,run,direction,target,reference\n")
    with pytest.raises(RigError, match="it has no rows"):
        read_reference(path, ["x"])
    path.write_text("axis,run,direction,target,reference\nx,1,up,0.0," + "0" * 200_000 + "\n")
    with pytest.raises(RigError, match="field larger than field limit"):
        read_reference(path, ["x"])
    with pytest.raises(RigError, match="No such file"):
        read_reference(tmp_path / "none.csv", ["x"])
    assert "nothing moves with --reference" in run("paper", "--live", "--reference", str(path))[1]
