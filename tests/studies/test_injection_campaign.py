"""The injection under faults and stops: a part of the campaign here, all of it in the slow lane; and proof that a rig
that leaves its tip inside, or says nothing of it, makes it fail.
"""

import os
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from hil.control.motion.injection.verdict import Phase
from hil.cycle.fault_table import Reaction
from hil.cycle.guards import Guards
from hil.cycle.output_gate import OutputGate
from hil.cycle.state_machine import State
from hil.cycle.supervisor import Supervisor
from hil.cycle.tick import CommandKind
from hil.cycle.withdrawal import Withdrawal
from hil.studies.fault_campaign.happenings import HAPPENINGS
from hil.studies.fault_campaign.injection import (
    ANOMALIES,
    GOOD,
    InjectionChunk,
    injection_campaign,
    plan,
    run_injection,
    with_cell,
)
from hil.studies.fault_campaign.matrix import Cell
from hil.studies.fault_campaign.report import led_out_lines
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.lockstep import LockstepRun
from hil.virtual.replay import replay_run
from tests.support.paths import RIGS

RIG = RIGS / "microscope.toml"
PHASES = [phase.name.lower() for phase in Phase if phase and phase is not Phase.PAUSED]


@cache
def chunk(anomaly: str, stride: int = 1, only: str = "") -> InjectionChunk:
    return next(found for found in plan([RIG], stride=stride, only=only) if found.anomaly == anomaly)


def failed(cells: list[Cell]) -> list[str]:
    assert cells
    return [f"{cell.checkpoint} / {cell.trial}: {cell.why}" for cell in cells if not cell.passed]


def test_every_reaction_and_eight_anomalies_are_asked_for() -> None:
    assert {happening.reaction for happening in HAPPENINGS} == set(Reaction)
    assert len(ANOMALIES) == 9
    names = [happening.name for happening in HAPPENINGS]
    assert len(set(names)) == len(names)


@pytest.mark.long
@pytest.mark.requirement(id="SR-8.4")
def test_an_operators_stop_leads_the_tip_out_from_each_of_the_ten_phases() -> None:
    cells = run_injection(chunk(GOOD, only="operator stops"))
    assert failed(cells) == []
    assert [cell.checkpoint for cell in cells] == [f"{GOOD}, {phase}" for phase in PHASES]
    assert {cell.reaction for cell in cells[1:]} == {"withdraw"}
    assert max(cell.out_ticks for cell in cells) < 250
    (line,) = led_out_lines(cells)
    led_out = sum(cell.reaction == "withdraw" for cell in cells)
    assert line.startswith(f"the tip was led out in {led_out} cells")


@pytest.mark.long
@pytest.mark.parametrize("anomaly", ["double", "stuck"])
def test_a_part_of_the_campaign_passes(anomaly: str) -> None:
    assert failed(run_injection(chunk(anomaly, stride=17))) == []


@pytest.mark.slow
def test_all_that_may_happen_in_every_phase_of_every_anomaly_passes() -> None:
    cells = injection_campaign([RIG], 1, os.cpu_count() or 1, lambda done, total: None)
    assert failed(cells) == []
    assert len(cells) > 1000
    assert {cell.checkpoint.split(", ")[1] for cell in cells} == set(PHASES)


Break = Callable[[pytest.MonkeyPatch], None]
BREAKS: dict[str, tuple[Break, str, str]] = {
    "the tip is not led out": (
        lambda m: m.setattr(Supervisor, "_lead_out", lambda self, tick: None), "operator stops", "at its safe height"
    ),
    "it is led out with an axis at fault": (
        lambda m: m.setattr(Withdrawal, "sound", lambda self, monitor: True), "encoder silent", "it was led out"
    ),
    "it goes half the way": (
        lambda m: m.setattr(Withdrawal, "over", lambda self, place, now_ns: now_ns > self._due_ns - 10**8),
        "termination signal", "at its safe height",
    ),
    "nothing is said of a tip that stays": (
        lambda m: m.setattr(Supervisor, "tip", property(lambda self: "")), "stop line", "the words say ''"
    ),
    "a motion that fails is held inside": (
        lambda m: m.setattr(Guards, "inside", lambda self: False), "motion raises", "ended ACTIVE"
    ),
}  # fmt: skip


@pytest.mark.long
@pytest.mark.replaces_methods
@pytest.mark.parametrize(("broken", "only", "why"), BREAKS.values(), ids=BREAKS)
def test_a_broken_way_out_makes_it_fail(broken: Break, only: str, why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    broken(monkeypatch)
    found = failed(run_injection(chunk("not_pierced", stride=3, only=only)))
    assert any(why in line for line in found), found


@pytest.mark.long
@pytest.mark.replaces_methods
def test_a_valve_that_stays_open_while_the_tip_leaves_makes_it_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    honest = OutputGate.release
    monkeypatch.setattr(OutputGate, "release", lambda self, asked, permitted: honest(self, 1, permitted=True))
    found = failed(run_injection(chunk("not_pierced", stride=3, only="operator stops")))
    assert any("pulses into what is not pierced" in line for line in found), found


@pytest.mark.long
def test_a_stop_in_a_cell_is_led_out_of_the_same_way_in_a_replay(tmp_path: Path) -> None:
    (rig,) = with_cell(RIG, [GOOD])
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, RIG)
    run = LockstepRun(rig, RIGS, observer=recorder.observe, operator=lambda run, index: _stops_in_the_cell(run))
    while run.activated_at < 0 or run.cycle.state is not State.READY:
        run.tick()
        assert run.index < 2500
    recorder.close()
    assert run.stage.dish is not None
    assert run.stage.dish.cells[0].touched_ns is not None
    assert run.stage.dish.entered is None
    report = replay_run(tmp_path / "run.mcap")
    assert (report.ticks, report.gap_at) == (run.index, None)
    assert not report.different


def _stops_in_the_cell(run: LockstepRun) -> list[CommandKind]:
    if run.cycle.state is State.READY:
        return [CommandKind.ACTIVATE] if run.activated_at < 0 else []
    decided = run.cycle.supervisor.goals.decided
    assert decided is not None
    return [CommandKind.STOP] if decided.phase == Phase.ADVANCE else []


def test_no_cell_led_out_is_no_line() -> None:
    assert led_out_lines([]) == []
