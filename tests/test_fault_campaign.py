"""The fault campaign: a sample of it here, all of it in the slow lane; and proof that a broken safety core makes it
fail.
"""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.frame import Frame
from hil.campaign.command import campaign
from hil.campaign.trials import TRIALS
from hil.campaign.voyage import Cell, Checkpoint, Leg, active, bring_to, displaced, in_fork, legs, run_cell, sail
from hil.config import RigConfig, load_rig
from hil.cycle import ControlCycle
from hil.faults import REACTIONS, Fault, FaultMonitor, Reaction
from hil.gate import TorqueGate
from hil.inbox import Inbox
from hil.state_machine import TABLE, Event, State
from hil.stop import DampedStop

RIGS = Path(__file__).parent.parent / "deploy" / "rigs"
STRIDE = 4  # about a thousand cells of the two rigs


def rig_of(name: str) -> RigConfig:
    return displaced(load_rig(RIGS / f"{name}.toml"))


LEGS = [leg for name in ("microscope", "paper") for leg in legs(rig_of(name), RIGS, stride=STRIDE)]


@pytest.mark.parametrize("leg", LEGS, ids=[f"{leg.document['name']}, {leg.point.name}" for leg in LEGS])
def test_every_fault_here_is_seen_in_time_and_answered_as_demanded(leg: Leg) -> None:
    failed = [f"{cell.trial} / {cell.axis}: {cell.why}" for cell in sail(leg) if not cell.passed]
    assert failed == []


def test_the_sample_has_a_thousand_cells() -> None:
    assert sum(len(leg.cells) for leg in LEGS) >= 1000


@pytest.mark.slow
def test_the_whole_campaign_passes_on_every_rig_we_ship() -> None:
    cells = campaign(sorted(RIGS.glob("*.toml")), 1, os.cpu_count() or 1, lambda done, total: None)
    assert [f"{c.rig}: {c.checkpoint} / {c.trial} / {c.axis}: {c.why}" for c in cells if not c.passed] == []
    assert len(cells) > 4000


def cell(trial_name: str, point: Checkpoint, sabotage: Callable[[], None] = lambda: None) -> Cell:
    rig = rig_of("paper")
    (trial,) = [trial for trial in TRIALS if trial.name == trial_name]
    run = bring_to(rig, RIGS, point)
    sabotage()
    return in_fork(lambda: run_cell(trial, point, 0, run, rig.name))


ON_THE_WAY = active("approach", 1000)
READY = Checkpoint("READY", State.READY, 100)


def test_a_campaign_reruns_bit_for_bit() -> None:
    assert cell("encoder silent", ON_THE_WAY) == cell("encoder silent", ON_THE_WAY)


def never(*arguments: object, **keywords: object) -> None:
    return None


def react(patch: pytest.MonkeyPatch, fault: Fault, reaction: Reaction) -> None:
    changed = [reaction if number == fault else honest for number, honest in enumerate(REACTIONS)]
    patch.setattr("hil.faults.REACTIONS", changed)
    patch.setattr("hil.campaign.voyage.REACTIONS", changed)


Break = Callable[[pytest.MonkeyPatch], None]


def open_gate(self: TorqueGate, sequence: int, reset: bool = False) -> list[Frame]:
    return self.release(np.ones(2), np.zeros(2), permitted=True, sequence=sequence)


def unlimited(request: float, *others: object) -> float:
    return request


def always(*arguments: object) -> bool:
    return True


def believed(*arguments: object) -> bool:
    return False


NOT_SILENT = property(believed, never)
BROKEN: list[tuple[str, Break, str, Checkpoint, str]] = [
    (
        "the gate lets torque out in every state",
        lambda m: m.setattr(TorqueGate, "zero", open_gate),
        "drive fault bit",
        ON_THE_WAY,
        "enable 3 in FAULT",
    ),
    (
        "the gate forgets to clamp",
        lambda m: m.setattr("hil.gate.limit_force", unlimited),
        "law asks for 1e9",
        ON_THE_WAY,
        "must not let it pass",
    ),
    (
        "the gate takes NaN for a number",
        lambda m: m.setattr(TorqueGate, "finite", staticmethod(always)),
        "law asks for NaN",
        ON_THE_WAY,
        "",
    ),
    (
        "silence is not noticed",
        lambda m: m.setattr(FaultMonitor, "check_samples", never),
        "encoder silent",
        ON_THE_WAY,
        "detected",
    ),
    (
        "bus errors are not noticed",
        lambda m: m.setattr(FaultMonitor, "check_bus", never),
        "bus-off",
        READY,
        "ENCODER_DEAD",
    ),
    (
        "any jump is believed",
        lambda m: m.setattr(FaultMonitor, "implausible", believed),
        "encoder jump",
        READY,
        "detected",
    ),
    (
        "motion is not watched",
        lambda m: m.setattr(FaultMonitor, "check_motion", never),
        "setpoint too fast",
        ON_THE_WAY,
        "detected",
    ),
    (
        "sequence numbers are not looked at",
        lambda m: m.setattr(Inbox, "_reject", never),
        "duplicates",
        ON_THE_WAY,
        "detected",
    ),
    (
        "a row of the fault table is too mild",
        lambda m: react(m, Fault.DRIVE_FAULT, Reaction.STOP),
        "drive fault bit",
        ON_THE_WAY,
        "at least ZERO is demanded",
    ),
    (
        "a row of the fault table only counts",
        lambda m: react(m, Fault.INTERFACE_DOWN, Reaction.COUNT),
        "interface down",
        READY,
        "",
    ),
    (
        "a row of the state table leads back to ACTIVE",
        lambda m: m.setitem(TABLE, (State.ACTIVE, Event.FAULT_ZERO), State.ACTIVE),
        "drive fails",
        ON_THE_WAY,
        "",
    ),
    (
        "a damped stop pushes on",
        lambda m: m.setattr(DampedStop, "over", believed),
        "operator stops",
        ON_THE_WAY,
        "STOPPING",
    ),
    (
        "R4 goes on sending",
        lambda m: m.setattr(ControlCycle, "silent", NOT_SILENT, raising=False),
        "bus-off",
        ON_THE_WAY,
        "silence",
    ),
]


@pytest.mark.parametrize(("what", "sabotage", "trial", "point", "says"), BROKEN, ids=[row[0] for row in BROKEN])
def test_a_broken_safety_core_fails_the_campaign_and_it_says_where(
    monkeypatch: pytest.MonkeyPatch, what: str, sabotage: Break, trial: str, point: Checkpoint, says: str
) -> None:
    assert cell(trial, point).passed, "the honest core passes"
    outcome = cell(trial, point, lambda: sabotage(monkeypatch))
    assert not outcome.passed
    assert outcome.trial == trial
    assert outcome.checkpoint == point.name
    assert says in outcome.why
