"""Cells told from the records of ticks alone, beside what the motion itself says of them."""

from math import isnan
from typing import Any

import numpy as np
import pytest

from hil.control.motion.injection.verdict import CellResult, Phase, Verdict
from hil.cycle.record import RECORD
from hil.rig.schema import RigConfig
from hil.telemetry.cell_watch import FIELDS, MOST_POINTS, CellWatch, Told, Trace
from hil.virtual.lockstep import LockstepRun
from tests.support.cells import RIGS, equipped
from tests.support.records import kept, table

KINDS = ("", "no_cell", "not_pierced", "clogged")


@pytest.fixture(scope="module")
def ran() -> tuple[RigConfig, np.ndarray, list[CellResult]]:
    """The records of a batch, and the motion's own results."""
    rig = equipped(4, anomalies=KINDS)
    rows: list[np.void] = []
    run = LockstepRun(rig, RIGS, observer=lambda tick, frames, result: rows.append(kept(result.record)))
    decided = run.cycle.supervisor.goals.decided
    assert decided is not None
    while decided.runs or len(decided.motion.results) < len(KINDS):
        run.tick()
        assert run.index < 8000
    run.tick()
    return rig, table(rows), decided.motion.results


def told_by(rig: RigConfig, records: np.ndarray, size: int, **more: Any) -> tuple[list[Told], CellWatch]:
    watch = CellWatch(rig, **more)
    return [told for at in range(0, len(records), size) for told in watch.add(records[at : at + size])], watch


@pytest.mark.long
def test_the_records_say_what_the_motion_says(ran: tuple[RigConfig, np.ndarray, list[CellResult]]) -> None:
    rig, records, results = ran
    over = [told.result for told in told_by(rig, records, 512)[0] if told.over]
    assert [(r.number, r.verdict) for r in over] == [(r.number, r.verdict) for r in results]
    assert {r.verdict for r in over} == {Verdict.OK, Verdict.NO_CELL, Verdict.NOT_PIERCED, Verdict.CLOGGED}
    for told, own in zip(over, results, strict=True):
        for name, near in (
            ("began_s", 2e-3), ("ended_s", 2e-3), ("found", 2e-6), ("pierced", 2e-6), ("pierced_force", 2e-5),
            ("peak_force", 2e-5), ("deposit", 50e-6), ("pulse_s", 2e-3), ("bolus", 1e-9), ("pull", 2e-5),
        ):  # fmt: skip
            value, wanted = getattr(told, name), getattr(own, name)
            assert isnan(value) == isnan(wanted), (told.number, name)
            assert isnan(wanted) or value == pytest.approx(wanted, abs=near), (told.number, name)


@pytest.mark.long
def test_it_does_not_matter_how_the_ticks_are_cut(ran: tuple[RigConfig, np.ndarray, list[CellResult]]) -> None:
    rig, records, _ = ran
    few = np.empty(len(records), [(name, RECORD[name]) for name in FIELDS])
    for name in FIELDS:
        few[name] = records[name]
    wanted = [repr(told) for told in told_by(rig, records, len(records))[0]]
    for size in (1, 7, 512):
        assert [repr(told) for told in told_by(rig, few, size)[0]] == wanted


@pytest.mark.long
def test_messages_go_phase_by_phase_and_end_with_the_verdict(
    ran: tuple[RigConfig, np.ndarray, list[CellResult]],
) -> None:
    rig, records, _ = ran
    told, watch = told_by(rig, records, 512, keep=True)
    first = [watch.tell(one) for one in told if one.result.number == 0]
    assert [message.phase for message in first] == [
        phase.name.lower() for phase in Phase if Phase.NONE < phase < Phase.PAUSED
    ] + [""]
    assert [message.verdict for message in first[:-1]] == [""] * 10
    assert (first[-1].verdict, first[-1].number, first[-1].of) == ("ok", 1, 4)
    assert isnan(first[0].contact)
    assert watch.traces is not None
    assert sorted(watch.traces) == [0, 1, 2, 3]
    deepest = max(zip(watch.traces[0].force, watch.traces[0].depth, strict=True))
    assert deepest[0] > 5e-4
    assert 1e-4 < deepest[1] < 3.2e-4


def test_a_trace_is_thinned_out_evenly() -> None:
    trace = Trace()
    for start in range(0, 10_000, 100):
        trace.add([float(k) for k in range(start, start + 100)], [0.0] * 100)
    assert MOST_POINTS / 2 <= len(trace.depth) <= MOST_POINTS
    assert len({b - a for a, b in zip(trace.depth, trace.depth[1:], strict=False)}) == 1
