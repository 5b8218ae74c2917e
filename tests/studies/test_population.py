"""Many stages under one rig: made again from their numbers, run together, and each on its own."""

import numpy as np
import pytest

from hil.rig.file import load_rig
from hil.studies.population import CORNERS, FRICTION, MASS, between, drawn, run, stacked, truth_of
from hil.virtual.batch import BatchRun
from tests.support.paths import RIGS


def test_a_stage_s_numbers_follow_from_the_seed_and_its_own() -> None:
    first = [drawn(7, number).random() for number in range(50)]
    assert first == [drawn(7, number).random() for number in range(50)]
    assert len({*first, *(drawn(8, number).random() for number in range(50))}) == 100


@pytest.mark.parametrize(("part", "value"), [(0.0, 1e-7), (0.5, 1e-6), (1.0, 1e-5)])
def test_a_range_of_decades_is_drawn_by_its_logarithm(part: float, value: float) -> None:
    assert between((1e-7, 1e-5), part) == pytest.approx(value, rel=1e-12)


def test_the_corners_are_those_of_the_ranges_that_stages_are_drawn_from() -> None:
    assert {mass for mass, _ in CORNERS.values()} == set(MASS)
    assert {friction for _, friction in CORNERS.values()} == set(FRICTION)
    assert len(set(CORNERS.values())) == len(CORNERS) == 4


def test_stages_run_together_as_alone_and_one_that_diverges_takes_no_other_along() -> None:
    rig = load_rig(RIGS / "paper.toml")
    plants = [rig.plant.model_copy(update={"mass_scale": scale}) for scale in (1.0, 0.9)]
    lost = stacked(rig, plants)
    lost.mass[1] = np.nan
    alone, both = BatchRun(rig, truth_of(rig, plants[0])), BatchRun(rig, lost)
    told: list[tuple[str, int, int]] = []
    run(alone, range(40), lambda tick: None, lambda tick: None)
    run(
        both, range(40), lambda tick: told.append(("before", tick, both.index)),
        lambda tick: told.append(("after", tick, both.index)),
    )  # fmt: skip
    assert told == [step for tick in range(40) for step in (("before", tick, tick), ("after", tick, tick + 1))]
    assert np.array_equal(both.error[0], alone.error)
    assert np.abs(alone.force).max() > 0.0
    assert np.isnan(both.error[1]).all()
