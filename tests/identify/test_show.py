"""What an identification prints: whole names of quantities, in the units of each axis."""

from io import StringIO

import pytest
from rich.console import Console

from hil.identify.estimate import Estimate
from hil.identify.findings import Findings
from hil.identify.show import as_document, show
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from tests.support.paths import RIGS

WHY = "0.5 N RMS at a Coulomb friction of 2 N (at most 1 N s/m), longer than the travel of 0.008 m; 12 um"


@pytest.fixture(scope="module")
def rig() -> RigConfig:
    return load_rig(RIGS / "microscope.toml")


def one() -> Findings:
    found = {
        "mass": Estimate(2e-4, 1e-7, "kg"),
        "other_mode_1_frequency_hz": Estimate(260.0, 0.3, "Hz"),
        "other_mode_1_damping": Estimate(0.015, 5e-4, "1"),
        "other_mode_1_load": Estimate(0.1, 1e-3, "1"),
    }
    return Findings(found=found, refused={"coulomb": WHY}, validation=(0.1, 0.2))


def shown(rig: RigConfig, axis: str, width: int) -> str:
    text = StringIO()
    show(Console(file=text, width=width), rig, {axis: one()})
    return text.getvalue()


@pytest.mark.parametrize("width", [60, 80, 120])
def test_no_end_of_a_name_is_cut_off(rig: RigConfig, width: int) -> None:
    told = shown(rig, "x", width)
    assert "…" not in told
    cells = [line.split("│")[2].strip() for line in told.splitlines() if line.startswith("│")]
    assert "other_mode_1_frequency_hz" in "".join(cells)
    assert "other_mode_1_damping" in "".join(cells)


def test_a_refusal_has_the_units_of_its_axis(rig: RigConfig) -> None:
    assert f"x: coulomb refused: {WHY}" in shown(rig, "x", 120)
    turned = "0.5 N m RMS at a Coulomb friction of 2 N m (at most 1 N m s/rad), "
    turned += "longer than the travel of 0.008 rad; 12 urad"
    assert f"theta: coulomb refused: {turned}" in shown(rig, "theta", 120)
    assert as_document(rig, {"theta": one()}, "")["axes"]["theta"]["refused"] == {"coulomb": turned}


def test_a_document_has_the_units_of_its_axis(rig: RigConfig) -> None:
    axes = as_document(rig, {"x": one(), "theta": one()}, "")["axes"]
    assert [axes[name]["found"]["mass"]["unit"] for name in axes] == ["kg", "kg m^2"]
