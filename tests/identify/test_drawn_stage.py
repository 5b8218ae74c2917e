"""Drawn stages that once were identified wrongly."""

from pathlib import Path

import pytest

from hil.identify.lockstep import identify
from hil.identify.written import model_values
from hil.rig.file import load_rig
from hil.studies.evidence.stages import nominal, plant_of
from hil.studies.evidence.stages import only as axes_only
from tests.benchmarks.first_strokes import alone
from tests.support.paths import RIGS


@pytest.mark.long
def test_what_friction_does_below_the_lines_is_no_resonance() -> None:
    """A mode of 3 Hz took two thirds of the mass (0.70 kg of 0.21); written, it made the law lose the axis."""
    whole = nominal(load_rig(RIGS / "microscope.toml"), 0.0)
    plant = plant_of(whole, 95, 9, 0.0)
    stage = alone(axes_only(whole, ["z"]), plant, whole.axis_names.index("z"))
    found = identify(stage, Path(), ["z"], lambda text: None, only=("push", "frequency"))["z"]
    mass = found.found.get("mass")
    assert "chi^2" in found.refused["frequency"] if mass is None else mass.holds(plant.mass[2])  # type: ignore[index]


@pytest.mark.long
def test_a_stated_resonance_that_is_not_there_is_written_as_none() -> None:
    """The law would go on observing it."""
    rig = load_rig(RIGS / "microscope.toml")
    known = axes_only(nominal(rig, 150.0), ["x"])
    stage = alone(known, plant_of(nominal(rig, 0.0), 95, 3, 0.0), 0)
    found = identify(stage, Path(), ["x"], lambda text: None, only=("push", "frequency"))["x"]
    assert "no resonance" in found.refused["mode"]
    assert model_values(found.found)["mode_frequency_hz"] == 0.0
