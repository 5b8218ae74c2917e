"""A corner's axis, number by number: what slides is off by its factors, what is stuck hangs on a damped spring."""

import math
from itertools import product

import pytest

from hil.analysis.loop_corners import STUCK_DAMPING, Corner, CornerFinding, sliding_corners, stuck_corners
from hil.rig.tables import ModelConfig

MODEL = ModelConfig(
    mass=2.0, coulomb=0.5, viscous=3.0, torque_lag=2e-4, mode_frequency_hz=150.0, mode_damping=0.02, mode_load=0.3,
    presliding=[1e-6, 1e-4],
)  # fmt: skip


def test_a_sliding_corner_is_off_by_its_factors_alone() -> None:
    axis = Corner(mass=1.2, mode=0.9, lag=0.8, friction=0.7).dynamics(MODEL)
    assert axis is not None
    assert (axis.mass, axis.lag, axis.mode_hz) == (pytest.approx(2.4), pytest.approx(1.6e-4), pytest.approx(135.0))
    assert (axis.mode_damping, axis.mode_load, axis.viscous) == (0.02, 0.3, pytest.approx(2.1))
    assert (axis.stiffness, axis.damping) == (0.0, 0.0)


@pytest.mark.parametrize(("share", "distance"), [(0.0, 1e-6), (0.5, 1e-5), (1.0, 1e-4)])
def test_a_stuck_corner_hangs_on_its_friction_with_the_least_damping(share: float, distance: float) -> None:
    axis = Corner(mass=0.8, friction=1.3, stuck=share).dynamics(MODEL)
    assert axis is not None
    assert axis.viscous == 0.0
    assert axis.stiffness == pytest.approx(1.3 * 0.5 / distance)
    assert axis.damping / (2.0 * math.sqrt(axis.stiffness * 1.6)) == pytest.approx(STUCK_DAMPING)


def test_a_stage_without_stiction_has_no_stuck_corner() -> None:
    assert Corner(stuck=0.5).dynamics(MODEL.model_copy(update={"presliding": []})) is None
    assert Corner(stuck=0.5).dynamics(MODEL.model_copy(update={"coulomb": 0.0})) is None


def test_a_corner_is_named_by_what_is_off_in_it() -> None:
    assert Corner().text(MODEL) == "as the model says"
    assert Corner(0.8, 1.1, 1.2, 0.7).text(MODEL) == "mass -20%, mode +10%, lag +20%, viscous friction -30%"
    assert Corner(mass=1.2, stuck=0.5).text(MODEL) == "at rest on 10 um of presliding, mass +20%"


def test_the_corners_are_mass_and_mode_together_and_all_else_alone() -> None:
    mass, mode = (1.0, 0.8, 1.2), (1.0, 0.9, 1.1)
    alone = [Corner(lag=0.8), Corner(lag=1.2), Corner(friction=0.7), Corner(friction=1.3)]
    assert sliding_corners() == [*(Corner(m, f) for m, f in product(mass, mode)), *alone]
    off = [Corner(mass=0.8), Corner(mass=1.2), Corner(mode=0.9), Corner(mode=1.1)]
    assert stuck_corners() == [
        *(Corner(stuck=pytest.approx(k / 6)) for k in range(7)),
        *(corner._replace(stuck=share) for corner in off for share in (0.0, 0.5, 1.0)),
    ]


@pytest.mark.parametrize(
    ("nominal", "at_rest", "gain", "phase"),
    [
        (True, False, 6.0, 30.0),
        (False, False, 3.0, 15.0),
        (False, True, 4.5, 0.0),
    ],
)
def test_a_corner_lacks_what_its_kind_asks_for(nominal: bool, at_rest: bool, gain: float, phase: float) -> None:
    def finding(gain_db: float, phase_deg: float, *, stable: bool = True) -> CornerFinding:
        return CornerFinding("x", "mass +20%", at_rest, nominal, stable, gain_db, phase_deg, 123.4)

    assert finding(gain, phase).lacks() == ""
    lacking_gain = f"a gain margin of {gain - 0.1:.1f} dB (at least {gain:g})"
    lacking_phase = f"a phase margin of {phase - 1.0:.0f} deg (at least {phase:g})"
    for short, lacking in (
        (finding(gain - 0.1, phase), lacking_gain),
        (finding(gain, phase - 1.0), lacking_phase),
        (finding(gain - 0.1, phase - 1.0), f"{lacking_gain} and {lacking_phase}"),
    ):
        assert short.lacks() == f"axis 'x', mass +20%: {lacking} at 123 Hz"
        assert short.lacks(least=True) == ""
    ringing = "axis 'x', mass +20%: the loop is unstable; it rings at 123 Hz"
    assert finding(gain, phase, stable=False).lacks() == ringing
    assert finding(gain, phase, stable=False).lacks(least=True) == ringing


def test_a_finding_is_json_with_null_where_no_margin_is_met() -> None:
    assert CornerFinding("x", "mass +20%", False, False, True, 4.5, math.inf, 50.0).as_json() == {
        "axis": "x", "corner": "mass +20%", "at_rest": False, "stable": True, "gain_db": 4.5, "phase_deg": None,
        "frequency_hz": 50.0,
    }  # fmt: skip
