"""Drives that are bought: slow, coarse, sampling in their own time, and a stage that begins beside its middle."""

from pathlib import Path

import numpy as np
import pytest

from hil.identify.lockstep import identify
from hil.rig.file import load_rig
from hil.rig.shipped import by_name

PUSHED = ("odrive", "moteus", "cubemars", "damiao", "robstride")
RIGS = ("paper", "moteus", "odrive", "vesc", "cubemars", "damiao", "robstride")


@pytest.mark.long
@pytest.mark.parametrize("name", RIGS)
def test_mass_and_friction_of_the_shipped_rigs_are_found(name: str) -> None:
    file = by_name("rigs", Path(name))
    rig = load_rig(file)
    found = identify(rig, file.parent, ["y"], lambda _: None)["y"]
    assert found.ended == ""
    assert found.found["mass"].holds(float(np.broadcast_to(rig.plant.mass, 2)[1]))
    assert found.found["coulomb"].value == pytest.approx(float(np.broadcast_to(rig.plant.coulomb, 2)[1]), rel=0.02)
    assert "presliding" not in found.found, "the emulated guides have none"
    assert found.found["push_coulomb"].value == pytest.approx(found.found["coulomb"].value, rel=1.0)


@pytest.mark.long
@pytest.mark.parametrize("name", PUSHED)
def test_a_push_before_the_first_task_bears_a_model_that_is_to_be_found(name: str) -> None:
    """Of a mass 2.2 times the model's: all ended in AXIS_NOT_AS_STATED."""
    file = by_name("rigs", Path(name))
    model = load_rig(file).axes["y"].model
    rig = load_rig(file, [f"plant.mass={[2.2 * model.mass] * 2}", f"plant.coulomb={[model.coulomb] * 2}"])
    found = identify(rig, file.parent, ["y"], lambda _: None, only=("push",))["y"]
    assert found.ended == ""
    assert found.found["push_coulomb"].value == pytest.approx(model.coulomb, rel=1.0)
