"""SYNC with a counter and without: what is written to drives of either kind, and in which order."""

import pytest

from tests.drivers.families.cia402.test_drive_profiles import plan
from tests.support.foreign_drive import CST_DRIVE, U8, U32, Fact

CYCLE, COUNTER = (0x1006, 0), (0x1019, 0)  # 1019h may only be written while 1006h is zero (CiA 301, 7.5.2.22)


@pytest.mark.parametrize(
    ("asked", "stated", "steps"),
    [
        ("on", "0", [(*CYCLE, 0), (*COUNTER, 240), (*CYCLE, 1000)]),
        ("off", "240", [(*CYCLE, 0), (*COUNTER, 0), (*CYCLE, 1000)]),
        ("off", "0", [(*CYCLE, 1000)]),
        ("auto", "0", [(*CYCLE, 0), (*COUNTER, 240), (*CYCLE, 1000)]),
    ],
)
def test_the_cycle_is_cleared_before_the_counter_is_written_and_stated_behind_it(
    asked: str, stated: str, steps: list[tuple[int, int, int]]
) -> None:
    facts = CST_DRIVE | {CYCLE: Fact(U32, "rw", "1000"), COUNTER: Fact(U8, "rw", stated)}
    made = plan(facts, sync_counter=asked)
    found = [(step.object_index, step.subindex, step.value) for step in made.steps if step.size]
    assert [step for step in found if step[0] in (CYCLE[0], COUNTER[0])] == steps
    assert made.counter is (asked != "off")
