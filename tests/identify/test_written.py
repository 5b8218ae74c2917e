"""The rig file that identification writes: new values in, everything else as it was."""

from pathlib import Path

import pytest

from hil.identify.estimate import Estimate
from hil.identify.written import rig_text
from hil.rig.file import load_rig
from hil.rig.shipped import by_name

FOUND = {
    "mass": Estimate(1.2345678, 0.001, "kg"),
    "constant": Estimate(-0.5, 0.01, "N"),
    "presliding": Estimate(4e-6, 1e-6, "m"),
    "cogging_amplitude": Estimate(0.02, 0.001, "N"),
}


def test_what_is_written_is_a_rig_with_these_values(tmp_path: Path) -> None:
    source = by_name("rigs", Path("microscope"))
    made = tmp_path / "microscope.toml"
    made.write_text(rig_text(source, {"x": FOUND}, "hil identify, 2026-01-01, run.mcap sha256 0123"), encoding="utf-8")
    before, after = load_rig(source), load_rig(made)
    model = after.axes["x"].model
    assert (model.mass, model.gravity) == (1.23457, 0.5)
    assert model.presliding == pytest.approx([3e-6, 5e-6])
    assert model.coulomb == before.axes["x"].model.coulomb
    assert after.axes["y"] == before.axes["y"]
    text = made.read_text(encoding="utf-8")
    assert "run.mcap sha256 0123" in text
    assert "mass 1.2346 +- 0.001 kg" in text
    assert text.startswith(source.read_text(encoding="utf-8")[:200])
