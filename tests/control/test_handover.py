"""A law that takes over from another under torque: no step, no chain of them, and the same law as made at once."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from hil.control.laws import AxisLawMaker, designed_laws, make_axis_laws
from hil.control.laws.base import AxisLaws, axis_inputs
from hil.control.laws.handover import BLEND_S, Handover
from hil.control.nominal_model import rig_model
from hil.rig.file import load_rig
from tests.support.paths import RIGS

PERIOD_S, AXES = 1e-3, [axis_inputs(), axis_inputs()]
TICKS = round(BLEND_S / PERIOD_S)


class Constant:
    """AxisLaws that ask for one force; told: what it was reset with."""

    def __init__(self, *force: float, failure: str = "", floors: int = 0) -> None:
        self.own, self.failure, self.denominator_floors = list(force), failure, floors
        self.told: list[tuple[list[float], list[float]]] = []
        self.asked = 0

    def reset(self, position: Sequence[float], force: Sequence[float]) -> None:
        self.told.append((list(position), list(force)))

    def force(self, axes: Sequence[Any]) -> list[float]:
        self.asked += 1
        return list(self.own)


def test_the_force_goes_over_in_even_steps_and_the_old_law_is_asked_no_longer() -> None:
    old, new = Constant(1.0, -2.0), Constant(2.0, 0.0)
    law = Handover(old, new, PERIOD_S)
    AXES[0].position, AXES[1].position = 3e-3, 4e-3
    asked = np.array([law.force(AXES) for _ in range(TICKS + 10)])
    assert new.told == [([3e-3, 4e-3], [1.0, -2.0])], "once, with the force that acts"
    assert asked[0].tolist() == [1.0, -2.0]
    assert np.diff(asked, axis=0).max(0) == pytest.approx([1.0 / TICKS, 2.0 / TICKS])
    assert np.diff(asked, axis=0).min() == 0.0
    assert asked[TICKS:].tolist() == [[2.0, 0.0]] * 10
    assert (old.asked, new.asked) == (TICKS + 1, TICKS + 10)


def test_a_run_that_begins_has_the_new_law_at_once() -> None:
    law = Handover(Constant(1.0), new := Constant(2.0), PERIOD_S)
    law.reset([5e-3], [7.0])
    assert law.force(AXES[:1]) == [2.0]
    assert new.told == [([5e-3], [7.0])]


@pytest.mark.parametrize(("ticks", "first"), [(0, 1.0), (TICKS // 2, 1.5), (TICKS + 1, 2.0)])
def test_laws_that_are_set_one_after_the_other_make_no_step_and_no_chain(ticks: int, first: float) -> None:
    law: AxisLaws = Handover(Constant(1.0), Constant(2.0), PERIOD_S)
    for _ in range(ticks):
        law.force(AXES[:1])
    before = law.shortest() if isinstance(law, Handover) else law
    law = Handover(law, Constant(4.0), PERIOD_S)
    assert law.force(AXES[:1]) == [pytest.approx(first)]
    assert isinstance(before, Handover) is (ticks == TICKS // 2)


def test_floors_are_counted_on_and_a_failure_of_either_is_told() -> None:
    old, new = Constant(1.0, floors=3), Constant(2.0, floors=4)
    law = Handover(old, new, PERIOD_S)
    assert (law.denominator_floors, law.failure) == (7, "")
    old.failure = "mine"
    assert law.failure == "mine"
    new.failure = "its"
    assert law.failure == "its"


@pytest.mark.parametrize("name", ["presliding-kalman", "structured-kalman", "pid"])
def test_a_law_made_of_what_another_found_is_that_law_to_the_last_bit(name: str) -> None:
    rig = load_rig(RIGS / "microscope.toml")
    law = rig.law.model_copy(update={"name": name})
    model, limit = rig_model(rig), np.array([axis.limits.force for axis in rig.axes.values()])
    whole = make_axis_laws(law, model, PERIOD_S, limit)
    found = designed_laws(whole)
    assert bool(found) is (name == "presliding-kalman")
    maker, pieces = AxisLawMaker(law, model, PERIOD_S, limit, None, found), 1
    while not maker.work():
        pieces += 1
    assert pieces == len(rig.axes)
    other = maker.made()
    random, axes = np.random.default_rng(40), [axis_inputs() for _ in rig.axes]
    for _ in range(200):
        for x in axes:
            x.fresh, x.answered, x.sample_interval, x.ahead = 1.0, 1.0, PERIOD_S, PERIOD_S
            x.position, x.force_before = x.position + float(random.normal(0.0, 1e-7)), x.force_last
            x.start.velocity = x.end.velocity = x.sample.velocity = x.mean_velocity = 1e-3
        asked = whole.force(axes)
        assert other.force(axes) == asked
        for x, force in zip(axes, asked, strict=True):
            x.force_last = force
    assert designed_laws(other) == found
    assert any(asked)
