"""All experiments on stages of the tests' own: what is found of one bristle, and of many slip elements."""

import numpy as np
import pytest

from hil.identify.findings import Findings
from hil.identify.lockstep import identify
from tests.identify import rigs
from tests.identify.foreign_stage import ForeignStage
from tests.identify.stages import Bristle, Hung, MaxwellSlip

MASS, VISCOUS, COULOMB = 1.3, 4.0, 0.8


def found_of(friction: Bristle | MaxwellSlip, *hung: Hung) -> tuple[Findings, ForeignStage]:
    rig = rigs.one_axis()
    stage = ForeignStage(friction, MASS, VISCOUS, hung=hung)
    return identify(rig.config, rig.folder, ["x"], lambda _: None, runner=stage)["x"], stage


def shares(findings: Findings, **truth: float) -> dict[str, float]:
    return {name: abs(findings.found[name].value / value - 1.0) for name, value in truth.items()}


@pytest.mark.slow
def test_a_maxwell_slip_stage_is_identified() -> None:
    limits, lengths = np.full(8, COULOMB / 8), np.geomspace(0.3e-6, 60e-6, 8)
    findings, stage = found_of(MaxwellSlip(limits, limits / lengths))
    off = shares(findings, mass=MASS, coulomb=COULOMB, stiffness=float((limits / lengths).sum()))
    assert off["mass"] < 0.05
    assert off["coulomb"] < 0.02
    assert off["stiffness"] < 0.2
    assert "check" not in findings.refused
    assert max(stage.following.values()) < 0.6


@pytest.mark.slow
def test_a_bristle_is_identified() -> None:
    findings, stage = found_of(Bristle(COULOMB, 5e-6, 30.0))
    off = shares(findings, mass=MASS, coulomb=COULOMB, viscous=VISCOUS, presliding=5e-6, stiffness=COULOMB / 5e-6)
    assert off["mass"] < 0.003
    assert off["coulomb"] < 0.01
    assert off["viscous"] < 0.05
    assert off["presliding"] < 0.1
    assert off["stiffness"] < 0.1
    assert "check" not in findings.refused
    assert max(stage.following.values()) < 0.6


@pytest.mark.slow
def test_a_bristle_with_three_resonances_is_identified() -> None:
    tool, *others = (130.0, 0.02, 0.3), (240.0, 0.012, 0.06), (390.0, 0.015, 0.04)
    findings, stage = found_of(Bristle(COULOMB, 5e-6, 30.0), tool, *others)
    off = shares(findings, mass=MASS, coulomb=COULOMB, presliding=5e-6)
    assert off["mass"] < 0.005
    assert off["coulomb"] < 0.01
    assert off["presliding"] < 0.1
    for name, mode in zip(("mode", "other_mode_1", "other_mode_2"), (tool, *others), strict=True):
        found = [findings.found[f"{name}_{key}"].value for key in ("frequency_hz", "damping", "load")]
        assert found == pytest.approx(mode, rel=0.05), name
        assert found[0] == pytest.approx(mode[0], rel=0.002), name
    assert "check" not in findings.refused
    assert max(stage.following.values()) < 0.6
