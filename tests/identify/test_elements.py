"""Friction at rest that no single bristle has, on stages that the tests integrate."""

import numpy as np
import pytest

from hil.identify.elements import fit_elements, friction_at_rest, slipping
from hil.identify.estimate import Refused
from hil.identify.force_balance import Record
from tests.identify.stages import PERIOD, Bristle, MaxwellSlip, record
from tests.identify.test_force_balance import shrinking

MASS, VISCOUS, COULOMB = 0.9, 3.0, 0.6


def loops(friction: Bristle | MaxwellSlip) -> Record:
    force, position = record(friction, shrinking(0.8, 2.5, 9.6), 9.6, MASS, VISCOUS)  # type: ignore[arg-type]
    return Record(force, position, PERIOD, 5e-9, skip=400)


@pytest.mark.long
@pytest.mark.parametrize(("shortest", "longest", "count"), [(0.2e-6, 200e-6, 6), (0.5e-6, 50e-6, 8)])
def test_a_maxwell_slip_stage_shows_its_friction_and_stiffness(shortest: float, longest: float, count: int) -> None:
    limits, lengths = np.full(count, COULOMB / count), np.geomspace(shortest, longest, count)
    stage = loops(MaxwellSlip(limits, limits / lengths))
    found = fit_elements(stage, MASS, VISCOUS)
    assert found.coulomb.value == pytest.approx(COULOMB, rel=0.02)
    assert found.stiffness.value == pytest.approx(float((limits / lengths).sum()), rel=0.2)
    told, refused, _ = friction_at_rest(stage, MASS, VISCOUS)
    assert refused == {}
    assert told["stiffness"] == found.stiffness, "one bristle leaves more of the force"


@pytest.mark.long
def test_a_stage_of_one_bristle_stays_one() -> None:
    told, refused, _ = friction_at_rest(loops(Bristle(COULOMB, 5e-6, 30.0)), MASS, VISCOUS)
    assert refused == {}
    assert told["presliding"].value == pytest.approx(5e-6, rel=0.1)
    assert told["stiffness"].value == pytest.approx(COULOMB / 5e-6, rel=0.1)
    assert told["stiffness"].holds(COULOMB / 5e-6)


def test_an_element_slips_at_its_length_and_holds_behind() -> None:
    path = np.array([0.0, 1.0, 3.0, 2.0, -2.0])
    assert slipping(path, np.array([2.0]))[0].tolist() == [0.0, 0.5, 1.0, 0.5, -1.0]


def test_loops_of_a_few_counts_are_refused() -> None:
    position = 5e-9 * np.round(8.0 * np.sin(np.arange(2000) / 50.0))
    with pytest.raises(Refused, match="the encoder does not resolve their elements"):
        fit_elements(Record(np.sin(np.arange(2000) / 50.0), position, PERIOD, 5e-9), MASS, VISCOUS)
