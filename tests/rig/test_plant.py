"""Nominal model, drives and emulated stage: three things a rig file keeps apart, and none can differ unnoticed."""

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tomlkit

from hil.rig.file import build_rig, load_rig, rig_hash
from hil.rig.former_keys import FormerKeyWarning
from hil.rig.plant_notes import plant_notes
from hil.rig.provenance import describe_run, rig_of_run
from hil.rig.schema import RigError
from hil.virtual.lockstep import LockstepRun
from hil.virtual.sim import simulate
from tests.support.paths import RIGS

PAPER = RIGS / "paper.toml"
MICROSCOPE = RIGS / "microscope-ideal.toml"


def edited(tmp_path: Path, source: Path, edit: Callable[[Any], object]) -> Path:
    """A copy of a shipped rig file, changed."""
    document = tomlkit.parse(source.read_text())
    edit(document)
    path = tmp_path / source.name
    path.write_text(tomlkit.dumps(document))
    return path


def test_a_rig_file_without_a_plant_is_emulated_as_its_nominal_model_says(tmp_path: Path) -> None:
    rig = load_rig(edited(tmp_path, MICROSCOPE, lambda document: document.pop("plant")))
    models = [axis.model for axis in rig.axes.values()]
    assert rig.plant.mass == [model.mass for model in models]
    assert rig.plant.gravity == [0.0, 0.0, -2.45, 0.0]
    assert rig.plant.encoder_resolution == [5e-9] * 4
    assert plant_notes(rig) == [
        "emulated stage of microscope-ideal: mass, coulomb, viscous, gravity as the nominal model says"
    ]


def test_what_the_plant_states_stays_and_is_not_told() -> None:
    rig = load_rig(MICROSCOPE)
    assert rig.plant.mass == [0.93, 0.58, 0.26, 2.1e-4]
    assert plant_notes(rig) == []


def test_a_coarse_encoder_stated_once_is_also_emulated(tmp_path: Path) -> None:
    """It used to be emulated with 0.1 um, and every position was five times the true one: 16 mm of error."""

    def coarse(document: Any) -> None:
        for axis in document["axes"].values():
            axis["encoder_resolution"] = 5e-7

    path = edited(tmp_path, PAPER, coarse)
    rig = load_rig(path, ["task.radius=0.01", "task.approach_s=0.3", "task.settle_s=0.1"])
    report, _ = simulate(rig, path.parent, 1.0)
    assert not report.faults
    assert max(axis["max_error"] for axis in report.axes.values()) < 1e-4


def test_an_encoder_stated_twice_and_differently_is_a_modelling_error_with_a_line() -> None:
    rig = load_rig(PAPER, ["plant.encoder_resolution=1e-7", "axes.x.encoder_resolution=5e-7"])
    assert rig.plant.encoder_resolution == 1e-7
    (line,) = [note for note in plant_notes(rig) if "encoder" in note]
    assert "plant.encoder_resolution = 1e-07 on axis x" in line
    assert "5 times the true ones" in line


def test_the_emulated_drives_have_what_the_drives_table_says() -> None:
    rig = load_rig(MICROSCOPE, ["drives.watchdog_s=0.02"])
    drives = LockstepRun(rig, RIGS).stage.drives
    assert [drive.has_brake for drive in drives] == [False, False, True, False]
    assert {drive.watchdog_ns for drive in drives} == {20_000_000}


FORMER = {"plant": {"watchdog_s": 0.02, "brake": [False, True]}}


def test_a_file_of_an_earlier_version_loads_with_a_line_for_each_key(tmp_path: Path) -> None:
    def older(document: Any) -> None:
        document.pop("drives")
        document["plant"].update(FORMER["plant"])
        document["axes"]["y"]["safe"] = "brake"

    path = edited(tmp_path, PAPER, older)
    with pytest.warns(FormerKeyWarning) as told:
        rig = load_rig(path)
    assert (rig.drives.watchdog_s, rig.drives.brake) == (0.02, [False, True])
    lines = [str(warning.message) for warning in told]
    assert [line.partition("; write ")[2] for line in lines] == [
        "drives.brake = [false, true] instead",
        "drives.watchdog_s = 0.02 instead",
        "drives.brake = [false, true] instead",
    ]
    assert all(line.startswith(f"{path}: ") for line in lines)
    assert rig_hash(rig) == rig_hash(load_rig(PAPER, ["drives.watchdog_s=0.02", "drives.brake=[false, true]"]))


def test_a_former_key_that_contradicts_the_present_one_is_refused() -> None:
    with pytest.raises(RigError, match=r"plant\.watchdog_s = 0\.5: .*drives\.watchdog_s = 0\.01; remove"):
        load_rig(PAPER, ["plant.watchdog_s=0.5"])


@pytest.mark.parametrize("drives", [{}, {"brake": False}])
def test_safe_gives_way_to_a_stated_brake(drives: dict[str, bool]) -> None:
    document = json.loads(json.dumps(load_rig(PAPER).model_dump(mode="json")))
    document["drives"] = dict(drives)
    document["axes"]["x"]["safe"] = "brake"
    assert build_rig(document).drives.brake == (False if drives else [True, False])


def test_a_recording_of_an_earlier_version_gives_the_rig_it_was_made_with() -> None:
    rig = load_rig(MICROSCOPE)
    metadata = describe_run(rig, RIGS)
    old = json.loads(json.dumps(metadata))
    old["rig"]["plant"] |= old["rig"].pop("drives")
    for name, axis in old["rig"]["axes"].items():
        axis["safe"] = "brake" if name == "z" else "release"
    for recorded in (metadata, old):
        with warnings.catch_warnings(), rig_of_run(recorded) as (again, _):
            warnings.simplefilter("error")
            assert rig_hash(again) == rig_hash(rig)


@pytest.mark.parametrize(
    ("override", "note"),
    [
        ("plant.friction_scale=1.5", "mass as the nominal model says; coulomb, viscous, quadratic 1.5 times what the"),
        (
            "plant.mass_scale=0.8",
            "mass 0.8 times what the nominal model says; coulomb, viscous, quadratic as the nominal",
        ),
    ],
)
def test_a_stage_that_is_scaled_is_not_said_to_be_as_the_model(override: str, note: str) -> None:
    (line,) = plant_notes(load_rig(PAPER, [override]))
    assert note in line


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        ((), False),
        (("plant.stage=ideal",), True),
        (("plant.stage=ideal", "law.name=structured-kalman"), False),
        (("plant.stage=air-bearing",), False),
        (("plant.presliding=0.0",), True),
    ],
)
def test_a_law_for_presliding_on_guides_without_it_is_told(overrides: tuple[str, ...], told: bool) -> None:
    notes = plant_notes(load_rig(RIGS / "microscope.toml", overrides))
    assert any("law will hunt" in note for note in notes) == told
