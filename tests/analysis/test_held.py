"""A loop that holds its axis: what a push leaves comes back in time, or the rig is refused."""

import math

import numpy as np
import pytest

from hil.analysis.stability import OFFSET_S, check_stability, offset_s, refuse_unstable
from hil.rig.file import build_rig, load_rig
from hil.rig.law_names import LAWS
from hil.rig.schema import RigConfig, RigError
from tests.support.paths import RIGS

LIMITS = {"position": [-0.3, 0.3], "speed": 1.0, "force": 10.0, "force_rate": 1e4, "following_error": 0.002}
AXIS = {
    "encoder_resolution": 1e-7,
    "rated_force": 10.0,
    "limits": LIMITS,
    "model": {"mass": 1.0, "coulomb": 0.5, "viscous": 1.0},
}


def stage(law: str = "pd-feedforward", **gains: float) -> RigConfig:
    """One axis of 1 kg at 1 kHz."""
    return build_rig({"name": "mini", "axes": {"x": AXIS}, "law": {"name": law, "gains": gains}})


@pytest.mark.long
@pytest.mark.parametrize("kp", [0.0, 1e-9])
@pytest.mark.parametrize("kd", [2.0, 20.0, 200.0])
def test_a_law_without_stiffness_does_not_hold_its_axis(kp: float, kd: float) -> None:
    rig = stage(kp=kp, kd=kd)
    report = check_stability(rig)
    assert not report.stable
    assert "does not hold axis 'x'" in report.problems()[0]
    with pytest.raises(RigError, match="does not hold axis 'x' at 1000 Hz: after a push it"):
        refuse_unstable(rig)


@pytest.mark.long
@pytest.mark.parametrize("kd", [2.0, 20.0, 200.0])
def test_the_time_back_is_that_of_the_slow_pole(kd: float) -> None:
    """kp over kd is the rate of return: 1 % is left after 4.6 kd / kp seconds."""
    for seconds in (100.0, 400.0, 1000.0):
        axis = check_stability(stage(kp=4.6 * kd / seconds, kd=kd)).axes["x"]
        assert axis.offset_s == pytest.approx(seconds, rel=0.05)
        assert axis.stable == (seconds < OFFSET_S)


@pytest.mark.long
def test_a_slow_loop_is_refused_beyond_ten_minutes_alone() -> None:
    refuse_unstable(stage(kp=0.1, kd=2.0))
    with pytest.raises(RigError, match=r"takes 9\d\d s to come back to 1% \(limit 600 s\)"):
        refuse_unstable(stage(kp=0.01, kd=2.0))


def test_a_loop_without_damping_is_unstable_and_no_more_than_that() -> None:
    report = check_stability(stage(kd=0.0))
    assert not report.stable
    assert report.axes["x"].offset_s == 0.0
    assert "is unstable on axis 'x'" in report.problems()[0]


@pytest.mark.long
@pytest.mark.parametrize("law", LAWS)
def test_every_law_of_ours_holds_its_axes_and_those_of_another_mass(law: str) -> None:
    for mass in (0.8, 1.0, 1.2):
        axes = [f"axes.{axis}.model.mass={value * mass}" for axis, value in (("x", 0.02218), ("y", 0.011386))]
        rig = load_rig(RIGS / "paper.toml", [f"law.name={law}", *axes])
        refuse_unstable(rig)
        assert all(axis.offset_s == 0.0 for axis in check_stability(rig).axes.values())


def test_what_swings_or_is_back_lasts_no_time() -> None:
    ticks = np.arange(4000.0)
    assert offset_s(np.exp(-ticks / 100.0), 1e-3) == 0.0
    assert offset_s(np.cos(ticks / 30.0), 1e-3) == 0.0
    assert offset_s(np.zeros(4000), 1e-3) == 0.0
    assert offset_s(np.full(4000, np.nan), 1e-3) == 0.0
    assert offset_s(np.ones(4000), 1e-3) == math.inf
    assert offset_s(-np.ones(4000), 1e-3) == math.inf
