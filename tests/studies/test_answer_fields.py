"""The table of field: every field of an answer has its bound, its fault and its cells; the cells pass."""

from pathlib import Path

import pytest

from docs.answers_page import OWN
from drivers.config import BusConfig
from drivers.protocols import host_protocol
from drivers.protocols.answer_fields import Field, bounds_of
from hil.cycle.fault_table import ROWS, Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.studies.fault_campaign.answer_fields import Pattern, field_trials, result_of
from hil.studies.fault_campaign.catalogue import TRIALS
from hil.studies.fault_campaign.checkpoints import CampaignRun
from hil.studies.fault_campaign.layout_capabilities import fixed_capabilities
from hil.studies.fault_campaign.matrix import displaced, plan_chunks, run_chunk
from hil.studies.fault_campaign.trial import BY_MOTION, GONE
from tests.support.paths import RIGS

SILENCE = {*GONE, Fault.BAD_FRAMES}  # what any answer comes to that is rejected for long


@pytest.mark.parametrize("field", Field)
def test_a_fault_watches_every_field_and_its_trials_latch_no_other(field: Field) -> None:
    guards = {fault for fault, row in ROWS.items() if field in row.guards}
    assert guards
    found = field_trials(TRIALS)[field]
    assert found
    for trial in found:
        if trial.certain and not trial.benign:
            assert guards & set(trial.faults), trial.name
            assert set(trial.faults) <= guards | SILENCE, trial.name


@pytest.mark.parametrize("name", OWN)
def test_every_cell_of_every_layout_says_what_comes_of_it(name: str) -> None:
    layout = host_protocol(BusConfig(protocol=name), 1, [1.0], Path())
    capabilities = fixed_capabilities(layout)
    assert list(bounds_of(layout)) == list(Field)
    for field, bound in bounds_of(layout).items():
        assert bound.bound
        assert bound.outside
        for pattern in Pattern:
            result = result_of(field, pattern, TRIALS, capabilities)
            assert result
            assert not result.endswith(": "), "a reason is given"


def test_what_a_layout_does_not_carry_is_told_as_such() -> None:
    cia402 = host_protocol(BusConfig(protocol="cia402"), 1, [1.0], Path())
    bounds, capabilities = bounds_of(cia402), fixed_capabilities(cia402)
    assert [field for field, bound in bounds.items() if not bound.carried] == [
        Field.COUNT,
        Field.SEQUENCE,
        Field.STAMP,
        Field.CAUSES,
        Field.CHECKSUM,
    ]
    assert result_of(Field.STAMP, Pattern.EVER, TRIALS, capabilities) == "not detectable: no time stamp"
    assert result_of(Field.COUNT, Pattern.DRIFT, TRIALS, capabilities) == "not detectable: no sequence number"


def test_a_drift_of_one_encoder_may_be_mastered_and_is_named_by_motion_alone() -> None:
    drift = next(trial for trial in field_trials(TRIALS)[Field.POSITION] if not trial.certain)
    assert set(drift.faults) == {*BY_MOTION, Fault.STANDSTILL}


@pytest.mark.requirement(id="SR-3.3")
@pytest.mark.parametrize("field", ["identifier", "length", "checksum", "sequence"])
def test_one_answer_that_is_rejected_is_told_in_its_tick_and_ten_at_the_limit_that_the_rig_states(field: str) -> None:
    one, ten = (
        next(trial for trial in TRIALS if trial.name == f"field: {field} wrong, {pattern.value}")
        for pattern in (Pattern.ONE, Pattern.TEN)
    )
    rig = load_rig(RIGS / "paper.toml", ["task.kind=hold"])
    run = active(rig)
    for k in range(2):  # a drive's own sample comes a tick later
        one.step(run, 0, k)
        run.tick()
    assert (run.cycle.monitor.counts[Fault.ENCODER_GAP], run.cycle.fault) == (1, Fault.NONE)
    run = active(rig)
    for k in range(10):
        ten.step(run, 0, k)
        run.tick()
        if run.cycle.fault is not Fault.NONE:
            break
    bound = {Fault.ENCODER_LOST: 3, Fault.BAD_FRAMES: 5, Fault.ANSWERS_DIFFER: 2}[run.cycle.fault]
    assert bound - 1 <= k <= ten.allowed(run.cycle.fault, rig) == bound + 1
    assert ten.allowed(Fault.STAMP, rig) == 11, "of one that waits for nothing"


def active(rig: RigConfig) -> CampaignRun:
    run = CampaignRun(rig, RIGS)
    run.asks = CommandKind.ACTIVATE
    while run.cycle.state is not State.ACTIVE:
        run.tick()
        assert run.index < 200
        run.asks = CommandKind.ACTIVATE
    return run


@pytest.mark.requirement(id="SR-3.3")
@pytest.mark.long
def test_the_cells_pass_at_rest() -> None:
    rig = displaced(load_rig(RIGS / "paper.toml"))
    ready = next(chunk for chunk in plan_chunks(rig, RIGS, only="field:") if chunk.point.name == "READY")
    cells = run_chunk(ready)
    assert len(cells) == 2 * 23
    assert [f"{cell.trial} / {cell.axis}: {cell.why}" for cell in cells if not cell.passed] == []
