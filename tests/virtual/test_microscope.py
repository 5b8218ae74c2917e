"""The microscope as it is shipped: crossed-roller guides, cables, a tool that rings, noise."""

import pytest

from hil.analysis.loop_corners import check_corners
from hil.rig.file import load_rig
from hil.virtual.sim import SimReport, simulate
from tests.support.paths import RIGS

RIG = RIGS / "microscope.toml"
PLAN_S = 12.4  # s, the whole plan up to the way home, for which theta sets off after ten seconds of rest
PEAK, RMS = 4.5e-6, 0.5e-6  # m (rad), of the injection plan without learning: 95 % of stages


def track(*overrides: str, seconds: float) -> SimReport:
    report, _ = simulate(load_rig(RIG, overrides), RIGS, seconds)
    return report


def holds(report: SimReport) -> None:
    assert (report.state, report.law, report.faults) == ("ACTIVE", "presliding-kalman", {})
    assert max(axis["rms_error"] for axis in report.axes.values()) < RMS
    assert max(axis["max_error"] for axis in report.axes.values()) < PEAK


@pytest.mark.long
def test_the_injection_plan_begins_within_half_a_micrometre_on_guides_as_they_are() -> None:
    holds(track(seconds=5.0))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_whole_plan_is_held_whatever_the_noise(seed: int) -> None:
    holds(track(f"plant.seed={seed}", seconds=PLAN_S))


@pytest.mark.slow
@pytest.mark.parametrize(("mass", "friction"), [(0.9, 0.8), (0.9, 1.2), (1.1, 0.8), (1.1, 1.2)])
def test_a_stage_off_its_model_is_held_too(mass: float, friction: float) -> None:
    holds(track(f"plant.mass_scale={mass}", f"plant.friction_scale={friction}", seconds=PLAN_S))


@pytest.mark.slow
def test_its_law_has_the_margins_that_are_asked_for_in_every_corner() -> None:
    found = check_corners(load_rig(RIG))
    assert [finding.lacks() for finding in found if not finding.nominal and finding.lacks()] == []
    assert all(finding.stable for finding in found)


@pytest.mark.slow
def test_a_law_under_which_the_tool_would_ring_is_refused_and_it_would_have() -> None:
    """PD with the gains it takes by default is stable on a rigid stage alone."""
    found = check_corners(load_rig(RIG, ["law.name=pd-feedforward"]))
    assert {finding.axis for finding in found if not finding.stable} == {"x", "y", "z", "theta"}
    assert track("law.name=pd-feedforward", seconds=0.5).state == "FAULT"
