"""The rig file that identification writes: new values in, everything else as it was."""

import tomllib
from pathlib import Path

import pytest

from drivers.base.toml_file import toml_text
from hil.analysis.loop_corners import check_corners
from hil.analysis.stability import REALISED
from hil.identify.estimate import Estimate
from hil.identify.written import measured_values, rig_text
from hil.operate.check_loop import measured_notes
from hil.rig.file import build_rig, load_rig
from hil.rig.measured_table import Tolerances, changed
from hil.rig.shipped import by_name
from hil.runs.measured_trend import trends

FOUND = {
    "mass": Estimate(1.2345678, 0.001, "kg"),
    "constant": Estimate(-0.5, 0.01, "N"),
    "presliding": Estimate(4e-6, 1e-6, "m"),
    "cogging_amplitude": Estimate(0.02, 0.001, "N"),
}


def test_what_is_written_is_a_rig_with_these_values(tmp_path: Path) -> None:
    source = by_name("rigs", Path("microscope"))
    made = tmp_path / "microscope.toml"
    made.write_text(
        rig_text(source, {"x": FOUND}, "2026-01-01", "run.mcap sha256 0123", {"x": (0.01, 0.02)}), encoding="utf-8"
    )
    before, after = load_rig(source), load_rig(made)
    model = after.axes["x"].model
    assert (model.mass, model.gravity) == (1.23457, 0.5)
    assert model.presliding == pytest.approx([3e-6, 5e-6])
    assert model.coulomb == before.axes["x"].model.coulomb
    assert before.axes["x"].measured is None
    assert after.axes["y"] == before.axes["y"]
    text = made.read_text(encoding="utf-8")
    assert "run.mcap sha256 0123" in text
    measured = after.axes["x"].measured
    assert measured is not None
    assert measured.validation == [0.01, 0.02]
    assert (measured.mass, measured.gravity, measured.viscous) == ([1.23457, 0.001], [0.5, 0.01], None)
    assert (measured.date, measured.evidence) == ("2026-01-01", "run.mcap sha256 0123")
    assert text.startswith(source.read_text(encoding="utf-8")[:200])


@pytest.mark.parametrize("drag", [0.00265, 0.0])
def test_drag_is_written_and_one_that_was_stated_falsely_goes(drag: float) -> None:
    """Where a straight line explains friction, it has the force of the drag in it."""
    found = {"viscous": Estimate(0.04, 0.001, "N s/m")}
    told = found | ({"quadratic": Estimate(drag, 1e-5, "N s^2/m^2")} if drag else {})
    assert measured_values(told).get("quadratic") == ([drag, 1e-5] if drag else None)
    text = rig_text(by_name("rigs", Path("paper")), {"y": told}, "2026-01-01", "a")
    assert build_rig(tomllib.loads(text)).axes["y"].model.quadratic == drag


def test_a_rig_file_whose_axes_stand_on_one_line_is_written_too(tmp_path: Path) -> None:
    source, made = tmp_path / "one-line.toml", tmp_path / "made.toml"
    whole = load_rig(by_name("rigs", Path("microscope"))).model_dump(mode="json", exclude_none=True)
    source.write_text(toml_text(whole), encoding="utf-8")
    made.write_text(rig_text(source, {"x": FOUND, "z": FOUND}, "2026-01-01", "a"), encoding="utf-8")
    after = load_rig(made)
    for axis in (after.axes["x"], after.axes["z"]):
        assert axis.model.mass == 1.23457
        assert axis.measured is not None
        assert axis.measured.mass == [1.23457, 0.001]


def test_a_second_identification_is_written_over_the_first_and_its_changes_are_told(tmp_path: Path) -> None:
    first, second = tmp_path / "first.toml", tmp_path / "second.toml"
    first.write_text(rig_text(by_name("rigs", Path("microscope")), {"x": FOUND}, "2026-01-01", "a"), encoding="utf-8")
    again = {**FOUND, "mass": Estimate(1.236, 0.001, "kg"), "constant": Estimate(-0.505, 0.002, "N")}
    second.write_text(rig_text(first, {"x": again}, "2026-02-01", "b"), encoding="utf-8")
    old, new = load_rig(first).axes["x"].measured, load_rig(second).axes["x"].measured
    assert old is not None
    assert new is not None
    assert (new.mass, new.date, new.evidence) == ([1.236, 0.001], "2026-02-01", "b")
    assert changed(old, measured_values(again)) == ["mass was 1.2346 +- 0.001, is 1.236 +- 0.001"]
    assert changed(old, measured_values(FOUND)) == []


def other(number: int, hertz: float, wide: float) -> dict[str, Estimate]:
    values = {"frequency_hz": (hertz, wide, "Hz"), "damping": (0.01, 1e-4, "1"), "load": (0.05, 1e-3, "1")}
    return {f"other_mode_{number}_{key}": Estimate(*one) for key, one in values.items()}


def test_resonances_beside_the_tools_are_written_compared_and_bound_the_corners(tmp_path: Path) -> None:
    source, first, second = by_name("rigs", Path("microscope")), tmp_path / "first.toml", tmp_path / "second.toml"
    tool = {"torque_lag": Estimate(2e-4, 1e-6, "s"), "mode_frequency_hz": Estimate(196.0, 0.1, "Hz")}
    found = {**FOUND, **tool, **other(1, 280.0, 0.1), **other(2, 410.0, 12.3)}
    first.write_text(rig_text(source, {"x": found}, "2026-01-01", "a"), encoding="utf-8")
    axis = load_rig(first).axes["x"]
    assert axis.model.other_modes == [[280.0, 0.01, 0.05], [410.0, 0.01, 0.05]]
    assert axis.measured is not None
    assert axis.measured.other_mode_2_frequency_hz == [410.0, 12.3]
    assert axis.tolerances.mode == pytest.approx(0.03), "of the one that is known least"
    by_hand = load_rig(first, ["axes.x.model.other_modes=[[280.0, 0.01, 0.05]]"])
    assert by_hand.axes["x"].tolerances.mode == 0.01
    rigid = load_rig(first, ["axes.x.model.mode_frequency_hz=0"])
    assert rigid.axes["x"].tolerances.mode == pytest.approx(0.03), "the response shows these, and no tool"
    later = {**FOUND, **tool, **other(1, 283.0, 0.1)}
    second.write_text(rig_text(first, {"x": later}, "2026-02-01", "b"), encoding="utf-8")
    assert load_rig(second).axes["x"].model.other_modes == [[283.0, 0.01, 0.05]]
    assert [one.quantity for one in trends(load_rig(first), load_rig(second)) if one.left] == [
        "other_mode_1_frequency_hz"
    ]
    second.unlink()
    second.write_text(rig_text(first, {"x": FOUND | tool}, "2026-02-01", "b"), encoding="utf-8")
    assert load_rig(second).axes["x"].model.other_modes == [], "the frequency response shows none"
    second.write_text(rig_text(first, {"x": FOUND}, "2026-02-01", "b"), encoding="utf-8")
    assert len(load_rig(second).axes["x"].model.other_modes) == 2, "nobody has looked"


def test_an_axis_whose_response_showed_no_resonance_is_measured_without_one(tmp_path: Path) -> None:
    made = tmp_path / "rigid.toml"
    found = {**FOUND, "torque_lag": Estimate(2e-4, 1e-6, "s")}
    made.write_text(rig_text(by_name("rigs", Path("microscope")), {"x": found}, "2026-01-01", "a"), encoding="utf-8")
    rigid = load_rig(made, ["axes.x.model.mode_frequency_hz=0"])
    assert rigid.axes["x"].tolerances.known == 1.0
    assert measured_notes(rigid)[0].endswith("mass 2 %, lag 5 %, viscous friction 30 %")
    assert load_rig(made, ["axes.x.model.mode_frequency_hz=150"]).axes["x"].tolerances.known == 0.0, "stated by hand"


@pytest.mark.long
def test_the_loop_is_tried_within_what_was_measured(tmp_path: Path) -> None:
    source = by_name("rigs", Path("microscope"))
    made = tmp_path / "microscope.toml"
    found = {"mass": Estimate(0.9, 1e-4, "kg"), "mode_frequency_hz": Estimate(196.0, 6.0, "Hz")}
    made.write_text(rig_text(source, {"x": found}, "2026-01-01", "a"), encoding="utf-8")
    rig = load_rig(made)
    assert rig.axes["x"].tolerances == pytest.approx((0.02, 6.0 / 196.0, 0.2, 0.3)), "at least 2 % of mass"
    assert load_rig(source).axes["x"].tolerances == Tolerances()
    assert load_rig(made, ["axes.x.model.mass=0.91"]).axes["x"].tolerances.mass == 0.2, "no longer what was measured"
    assert rig.axes["x"].tolerances.known == 0.0, "lag is not measured"
    corners = {one.corner for one in check_corners(rig, REALISED) if one.axis == "x"}
    assert "mass -2%, mode +3%" in corners
    assert "mass -20%, mode +10%" not in corners
    assert "mass -20%, mode +10%" in {one.corner for one in check_corners(rig, REALISED) if one.axis == "y"}
    assert measured_notes(rig) == [
        "axis 'x': corners from [axes.x.measured] of 2026-01-01: mass 2 %, resonance 3.1 %, lag 20 %, "
        "viscous friction 30 %"
    ]


def test_an_axis_is_known_as_well_as_its_least_known_value() -> None:
    assert Tolerances().known == 0.0
    assert Tolerances(0.02, 0.02, 0.05).known == Tolerances(0.01, 0.01, 0.01, 0.01).known == 1.0
    assert Tolerances(0.02, 0.03, 0.05).known == pytest.approx(0.5)
    assert Tolerances(0.03, 0.01, 0.05).known == pytest.approx(0.5)
    assert Tolerances(0.02, 0.01, 0.09).known == pytest.approx(0.2)
    assert Tolerances(0.02, 0.01, 0.3).known == 0.0, "worse than nobody knows"
