"""Every batch that the specification has a bar for: each is one that its rig accepts, and a missed bar is told."""

from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

import pytest

from hil.control.motion.injection.verdict import CellResult, Verdict
from hil.operate.check_sensor import check_sensor
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.studies.inject.batch import Batch, Injected, inject
from hil.studies.inject.equipment import middle, words
from hil.studies.inject.judge import judged
from hil.studies.inject.specification import EACH, ROWS, Row, anomalies_of, ended, named
from tests.support.paths import RIGS

RIG = RIGS / "microscope.toml"


def rig_of(row: Row, cells: int) -> RigConfig:
    plain = load_rig(RIG)
    x, y = middle(plain)
    places = [(x + 1e-3 * number, y) for number in range(cells)]
    kinds = anomalies_of(row, cells)
    return load_rig(RIG, (*words(plain, places, 1, 0.0, kinds, fd=True, how=dict(row.how)), *row.words))


@pytest.mark.parametrize("row", ROWS, ids=[row.name for row in ROWS])
def test_each_batch_is_one_that_its_rig_may_inject(row: Row) -> None:
    rig = rig_of(row, 2)
    assert [finding.text for finding in check_sensor(rig) if finding.refused] == []


def cell(anomaly: str = "", **more: Any) -> Injected:
    result = CellResult(0, Verdict.OK, pierced_s=1.0, pierced_speed=4e-3, found=1.0)
    found = Injected(result, anomaly, Verdict.OK, 1e-3, found_depth=30e-6, known_after=2e-3, lurch=1e-5)
    return replace(found, **more)


ROW = {row.name.split(",")[0]: row for row in reversed(ROWS)}


@pytest.mark.parametrize(
    ("name", "worse", "missed"),
    [
        ("good cells", {"known_after": 8e-3}, "puncture known after, ms, always"),
        ("good cells", {"known_after": nan}, "punctures that were none"),
        ("no cells", {"found_depth": nan}, "touches of nothing"),
        ("each kind of cell", {"anomaly": "double", "expected": Verdict.DOUBLE}, "verdict: double"),
        ("each kind of cell", {"wrong_pulses": 1}, "pulses into a cell that is whole"),
        ("sensor that fades in 2 s", {"peak_force": 1.6e-3}, "greatest force on any cell"),
        ("mouse-like cells", {"found_depth": 1e-5}, "touch known, um deep"),
        ("sensor on the pipette", {"expected": Verdict.STUCK}, "verdicts"),
    ],
)
def test_a_bar_that_is_missed_is_told_by_its_name(name: str, worse: dict[str, Any], missed: str) -> None:
    row = ROW[name]
    good = cell(found_depth=5e-6) if name == "mouse-like cells" else cell()

    def misses(batch: Batch) -> list[str]:
        return [line.name for line in named(row, row.bars(batch, 1.4e-3)) if line.holds is False]

    assert misses(Batch([good] * 10, planned=10)) == []
    assert f"{row.name}: {missed}" in misses(Batch([replace(good, **worse)] * 10, planned=10))


def test_a_batch_that_did_not_end_is_no_batch_that_holds() -> None:
    (line,) = ended(ROWS[0], Batch([cell()], planned=3, fault="ENCODER_LOST"))
    assert (line.holds, line.reached) == (False, "1 of 3: ENCODER_LOST")
    assert ended(ROWS[0], Batch([cell()], planned=1)) == []


def test_kinds_come_in_turn_so_that_a_small_batch_has_some_of_each() -> None:
    row = next(row for row in ROWS if row.anomalies == EACH)
    assert anomalies_of(row, 10) == [*EACH, *EACH[:2]]
    assert anomalies_of(ROWS[0], 10) == []


@pytest.mark.long
@pytest.mark.parametrize("name", ["0.4 mN held", "sensor on the pipette"])
def test_a_batch_of_one_cell_holds_every_bar(name: str) -> None:
    batch = inject(rig_of(ROW[name], 1), Path(RIGS))
    assert [line.name for line in ROW[name].bars(batch, 1.4e-3) if not line.holds] == []


@pytest.mark.long
def test_a_membrane_too_weak_for_the_force_to_be_held_is_expected_to_burst() -> None:
    row = ROW["0.4 mN held"]
    batch = inject(rig_of(replace(row, how={"z_law": "hold", "hold_force": 7e-4}), 6), Path(RIGS))
    assert {cell.expected for cell in batch.cells} == {Verdict.HELD, Verdict.BURST}
    assert all(cell.right for cell in batch.cells)
    peak = next(line for line in judged(batch, 1.4e-3, 7e-4) if line.name == "greatest force where one was held")
    assert peak.holds
