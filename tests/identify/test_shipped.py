"""Drives that are bought: slow, coarse, sampling in their own time, and a stage that begins beside its middle."""

from pathlib import Path

import numpy as np
import pytest

from hil.identify.lockstep import identify
from hil.rig.file import load_rig
from hil.rig.shipped import by_name

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
