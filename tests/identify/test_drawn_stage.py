"""Drawn stages that once were identified wrongly."""

from pathlib import Path

import pytest

from hil.identify.lockstep import identify
from hil.identify.written import model_values
from hil.rig.file import load_rig
from hil.studies.evidence.stages import nominal, plant_of
from hil.studies.evidence.stages import only as axes_only
from tests.benchmarks.first_strokes import alone
from tests.benchmarks.hidden_stages import hidden
from tests.support.paths import RIGS


@pytest.mark.long
def test_a_short_bristle_leaves_a_rigid_axis_its_mass() -> None:
    """Where the multisine turned the axis round, a mode of 3 Hz took two thirds of the mass (0.70 kg of 0.21)."""
    whole = nominal(load_rig(RIGS / "microscope.toml"), 0.0)
    plant = plant_of(whole, 95, 9, 0.0)
    stage = alone(axes_only(whole, ["z"]), plant, whole.axis_names.index("z"))
    found = identify(stage, Path(), ["z"], lambda text: None, only=("push", "frequency"))["z"]
    assert found.refused == {"mode": "no resonance in 4 to 480 Hz"}
    assert found.found["mass"].value == pytest.approx(plant.mass[2], rel=0.002)
    assert found.found["mass"].holds(plant.mass[2])


@pytest.mark.long
def test_a_stated_resonance_that_is_not_there_is_written_as_none() -> None:
    """The law would go on observing it."""
    rig = load_rig(RIGS / "microscope.toml")
    known = axes_only(nominal(rig, 150.0), ["x"])
    stage = alone(known, plant_of(nominal(rig, 0.0), 95, 3, 0.0), 0)
    found = identify(stage, Path(), ["x"], lambda text: None, only=("push", "frequency"))["x"]
    assert "no resonance" in found.refused["mode"]
    assert model_values(found.found)["mode_frequency_hz"] == 0.0


@pytest.mark.long
@pytest.mark.parametrize("number", [3, 13, 19])
def test_a_weight_whose_mass_is_stated_twice_too_large_is_held(number: int) -> None:
    """A loop of 25 Hz swung at 64 Hz on the friction's stiffness, and the push ended in OSCILLATION."""
    rig, truth = hidden("z", 20261128, number, 150.0, None)
    assert rig.axes["z"].model.mass == pytest.approx(2.0 * truth["mass"])
    findings = identify(rig, Path(), ["z"], lambda text: None, only=("push",))["z"]
    assert (findings.ended, findings.refused) == ("", {})
