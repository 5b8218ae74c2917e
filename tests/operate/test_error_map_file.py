"""Readings of a reference instrument become a rig whose axis is where it says."""

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from typer.testing import CliRunner

import hil
from hil.cli.app import build_app
from hil.control.error_map import ErrorMap
from hil.operate.accuracy import _by_encoder, approaches
from hil.operate.approach_file import Deviations, write_approaches
from hil.operate.error_map_file import corrections, write_corrected
from hil.rig.error_map_table import ErrorMapConfig
from hil.rig.file import learning_hash, learning_hashes, load_rig
from hil.rig.learnt_file import write_learnt_file
from tests.support.command_line import CommandLine
from tests.support.paths import RIGS

WRONG_SCALE = ["plant.encoder_resolution=[5.001e-9,5e-9,5e-9,5e-9]", "axes.x.encoder_resolution=5e-9"]  # by 2e-4


def even(targets: list[float], deviation: list[float]) -> Deviations:
    both = np.array([deviation, deviation]).T
    return Deviations(targets, both, both)


def test_the_map_is_reference_less_encoder_and_zero_at_zero() -> None:
    targets = [-0.01, 0.0, 0.01]
    found = corrections(even(targets, [3e-6, 5e-6, 8e-6]), even(targets, [1e-8, 1e-8, 1e-8]), None)
    assert found.correction == pytest.approx([-2e-6, 0.0, 3e-6], abs=1e-9)
    assert found.position == pytest.approx(np.array(targets) + 1e-8)


def test_a_second_map_corrects_what_the_first_one_left() -> None:
    """Positions by a corrected encoder are brought back to the encoder's own."""
    before = ErrorMapConfig(position=[-0.02, 0.02], correction=[-1e-4, 1e-4])
    targets = [-0.01, 0.0, 0.01]
    left = [-2e-6, 0.0, 4e-6]
    found = corrections(even(targets, left), even(targets, [0.0] * 3), before)
    first, both = ErrorMap(before.position, before.correction), ErrorMap(found.position, found.correction)
    for plain, target, rest in zip(found.position, targets, left, strict=True):
        assert first.corrected(plain) == pytest.approx(target, abs=1e-12)
        assert both.corrected(plain) == pytest.approx(target + rest, abs=1e-12)


def test_readings_that_no_scale_explains_are_refused() -> None:
    targets = [-0.01, 0.0, 0.01]
    with pytest.raises(ValidationError, match="is encoder_resolution right"):
        corrections(even(targets, [0.0, 0.0, 5e-4]), even(targets, [0.0] * 3), None)


@pytest.mark.long
def test_a_wrong_scale_is_gone_after_a_reference_was_read(tmp_path: Path) -> None:
    rig = hil.load_rig("microscope-ideal", WRONG_SCALE)
    with hil.motion(rig) as mover:
        before = approaches(mover, "x", 5, 2)
    readings = tmp_path / "readings.csv"
    write_approaches(readings, {"x": _by_encoder(before)})
    with readings.open() as file:
        rows = list(csv.DictReader(file))
    true = {"up": before.true_up, "down": before.true_down}
    for row in rows:
        place = before.targets.index(float(row["target"]))
        deviation = true[row["direction"]][place, int(row["run"]) - 1]
        row["reference"] = repr(float(before.targets[place] + deviation + 1e-3))  # its zero is elsewhere
    with readings.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    written = tmp_path / "corrected.toml"
    write_corrected(RIGS / "microscope-ideal.toml", rig.config, readings, written)
    with hil.motion(hil.load_rig(written, WRONG_SCALE)) as mover:
        after = approaches(mover, "x", 5, 2)
    assert np.abs(before.true_up).max() > 3e-6
    for sides in ((before.true_up, after.true_up), (before.true_down, after.true_down)):
        scale_before, scale_after = (np.ptp(side.mean(axis=1)) for side in sides)
        assert scale_after < 0.05 * scale_before


def test_a_map_needs_readings(tmp_path: Path) -> None:
    words = ["accuracy", "microscope-ideal", "--write", str(tmp_path / "new.toml")]
    done = CliRunner(env={"COLUMNS": "200"}).invoke(build_app("accuracy"), words)
    assert done.exit_code == 2
    assert "needs the readings of --reference FILE" in done.output


def test_a_corrected_file_runs_without_what_was_learnt_before(tmp_path: Path, hil_here: CommandLine) -> None:
    source, learnt = tmp_path / "stage.toml", tmp_path / "stage.learnt.json"
    shutil.copy(RIGS / "microscope.toml", source)
    plain = load_rig(source)
    state: dict[str, list[float]] = {axis: [] for axis in plain.axes}
    write_learnt_file(learnt, plain.name, learning_hash(plain), learning_hashes(plain), state)
    name = 'name = "presliding-kalman"'
    source.write_text(source.read_text().replace(name, f'{name}\nlearnt = "{learnt.name}"'))
    assert load_rig(source).law.learnt
    readings, written = tmp_path / "readings.csv", tmp_path / "corrected.toml"
    stops = [f"x,{run},{way}" for run in (1, 2) for way in ("up", "down")]
    rows = [f"{stop},{at},{at},{1.0001 * at}" for stop in stops for at in (-0.01, 0.01)]
    readings.write_text("\n".join(["axis,run,direction,target,encoder,reference", *rows]))
    done = hil_here("accuracy", str(source), "--reference", str(readings), "--write", str(written))
    assert done.returncode == 0, done.stderr
    assert "law.learnt is left out" in done.stdout
    corrected = load_rig(written)
    assert (corrected.law.learnt, corrected.axes["x"].error_map is not None) == ("", True)
