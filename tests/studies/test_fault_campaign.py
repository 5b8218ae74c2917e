"""The fault campaign: a sample of it here, all of it in the slow lane; over every frame layout, and what each of them
cannot tell; and proof that a broken safety core makes it fail.
"""

import json
import os
from collections.abc import Callable

import numpy as np
import pytest

from drivers.families.cia402.master import Master
from drivers.frame import Frame
from drivers.protocols.base import Sample
from hil.cli.app import main
from hil.cli.exit_status import EXIT_CONFIG
from hil.cycle.damped_stop import DampedStop
from hil.cycle.fault_monitor import REACTIONS, FaultMonitor
from hil.cycle.fault_table import ROWS, Fault, Reaction
from hil.cycle.gate import TorqueGate
from hil.cycle.inbox import Inbox
from hil.cycle.state_machine import TABLE, Event, State
from hil.cycle.supervisor import Supervisor
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.studies.fault_campaign.campaign import campaign
from hil.studies.fault_campaign.catalogue import TRIALS
from hil.studies.fault_campaign.checkpoints import (
    READY,
    CampaignRun,
    Checkpoint,
    active,
    bring_to,
    outside_the_task,
)
from hil.studies.fault_campaign.layout_capabilities import Capability, fixed_capabilities
from hil.studies.fault_campaign.matrix import Cell, Chunk, displaced, in_fork, plan_chunks, run_cell, run_chunk
from sim_plant.drives.servo import ServoDrive
from tests.golden.campaigns.tell import stories as kept_cell_by_cell
from tests.support.paths import RIGS

STRIDE = 24  # over a hundred cells of the two rigs; the slow lane tries all
LATE = ("transfer", "strike", "pierce", "dwell", "withdraw", "return", "done")  # long to come to: the slow lane's alone
# Every n-th cell of rigs that differ from others in their drives or their stage alone; `hil faults RIG` tries all.
STRIDES = {"microscope": 9, "moteus": 3, "vesc": 3, "damiao": 9, "cubemars": 9, "robstride": 9}
WHOLE = [path.stem for path in sorted(RIGS.glob("*.toml")) if path.stem not in kept_cell_by_cell()]
THIN = 32  # over the layouts they do not have


def rig_of(name: str, layout: str = "stage_fd") -> RigConfig:
    return displaced(load_rig(RIGS / f"{name}.toml", [f"bus.protocol={layout}"]))


def thin(layout: str) -> list[Chunk]:
    """A slice of the microscope's start, rest and first motion."""
    rig = rig_of("microscope-ideal", layout)
    return plan_chunks(rig, RIGS, stride=THIN)[: len(outside_the_task(rig)) + 2]


SAFEST = ~(Capability.ROOM | Capability.NODES)
CHUNKS = [
    chunk
    for name in ("microscope-ideal", "paper")
    for chunk in plan_chunks(rig_of(name), RIGS, stride=STRIDE)
    if not chunk.point.name.startswith(tuple(f"ACTIVE {phase}" for phase in LATE))
]
OTHERS = [chunk for layout in ("stage_classic", "cia402") for chunk in thin(layout)]


def name_of(chunk: Chunk) -> str:
    rig = json.loads(chunk.document)
    return f"{rig['name']}, {rig['bus']['protocol']}, {chunk.point.name}"


@pytest.mark.requirement(id="SR-9.6")
@pytest.mark.long
@pytest.mark.parametrize("chunk", CHUNKS + OTHERS, ids=map(name_of, CHUNKS + OTHERS))
def test_every_fault_here_is_seen_in_time_and_answered_as_demanded(chunk: Chunk) -> None:
    failed = [f"{cell.trial} / {cell.axis}: {cell.why}" for cell in run_chunk(chunk) if not cell.passed]
    assert failed == []


def test_the_sample_has_over_a_hundred_cells() -> None:
    assert sum(len(chunk.cells) for chunk in CHUNKS) >= 140


def test_every_fault_that_stops_the_stage_is_what_some_trial_asks_for() -> None:
    asked_for = {fault for trial in TRIALS for fault in trial.faults}
    # Provoked by test_cycle_faults.py, test_commissioning.py and test_homing.py in tests/cycle instead.
    alone = {Fault.ENABLE_TIMEOUT, Fault.HEARTBEAT_LOST, Fault.AXIS_NOT_AS_STATED, Fault.HOMING_FAILED}
    without = {fault for fault, rule in ROWS.items() if rule.reaction >= Reaction.STOP} - asked_for - alone
    assert not without, "hil/studies/fault_campaign/catalogue.py has no trial for these"


def test_every_row_names_trials_that_are_there_and_may_show_as_its_fault() -> None:
    trials = {trial.name: trial for trial in TRIALS}
    for fault, row in ROWS.items():
        for declared in row.trials:
            trial = trials[declared.name]
            assert trial.benign or fault in trial.faults or row.reaction < Reaction.STOP, (row.name, trial.name)
    assert len(trials) == len(TRIALS)


def test_trials_can_be_tried_by_name(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    chunks = plan_chunks(rig_of("paper"), RIGS, only="jammed")
    assert {TRIALS[index].name for chunk in chunks for index, _ in chunk.cells} == {"axis jammed"}
    assert {len(chunk.cells) for chunk in chunks} == {2}, "on every axis"
    monkeypatch.setattr("sys.argv", ["hil", "faults", "paper", "--only", "jamed"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "duplicates" in capsys.readouterr().err, "the names there are"


def failures(rig: str, stride: int, *overrides: str) -> list[str]:
    """Cells of a rig's campaign that do not pass; there must be some that do."""
    cells = campaign([RIGS / f"{rig}.toml"], stride, os.cpu_count() or 1, lambda done, total: None, overrides)
    assert len(cells) * stride > 500
    return [f"{c.rig}: {c.checkpoint} / {c.trial} / {c.axis}: {c.why}" for c in cells if not c.passed]


@pytest.mark.requirement(id="SR-9.6")
@pytest.mark.slow
@pytest.mark.parametrize("rig", WHOLE)
def test_the_whole_campaign_passes_on_every_rig_we_ship(rig: str) -> None:
    """But those of which every cell is compared with what it was: tests/virtual/test_reference.py."""
    assert failures(rig, STRIDES.get(rig, 1)) == []


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["microscope-ideal", "paper"])
@pytest.mark.parametrize("layout", ["stage_classic", "cia402"])
def test_the_whole_campaign_passes_over_the_layouts_they_do_not_have(layout: str, rig: str) -> None:
    assert failures(rig, 1, f"bus.protocol={layout}") == []


@pytest.mark.parametrize(
    ("layout", "capabilities"),
    [
        ("stage_fd", SAFEST),
        ("stage_classic", SAFEST),
        ("cia402", Capability.NODES | Capability.STATE | Capability.RESET),
        ("moteus", Capability.STATE | Capability.CAUSE | Capability.RESET),
    ],
)
def test_what_a_layout_gives_is_what_its_frames_show(layout: str, capabilities: Capability) -> None:
    """Held against the frames: an answer with any one bit inverted, and one of the tick before last."""
    run = bring_to(rig_of("moteus" if layout == "moteus" else "microscope-ideal", layout), RIGS, READY)
    assert fixed_capabilities(run.cycle.protocol) == capabilities
    protocol, modulus = run.cycle.protocol, run.cycle.protocol.sequence_modulus
    answers = [frame for frame in run.received if isinstance(protocol.decode(frame), Sample)]
    assert len(answers) == len(run.rig.axes)
    for answer in answers:
        value, length = int.from_bytes(answer.data, "little"), len(answer.data)
        damaged = [answer._replace(data=(value ^ 1 << bit).to_bytes(length, "little")) for bit in range(8 * length)]
        accepted = [isinstance(protocol.decode(frame), Sample) for frame in damaged]
        assert any(accepted) is not (Capability.CHECKSUM in capabilities)
    run.on(2)
    inbox = Inbox(protocol, 100)
    inbox.collect(answers, run.cycle.sent_sequence)
    assert any(inbox.fresh) is not (Capability.SEQUENCE in capabilities)
    assert (modulus > 0) is (Capability.SEQUENCE in capabilities)


def test_the_operator_acts_when_the_rig_is_ready_and_that_is_the_runs_own_affair() -> None:
    began = {}
    for layout in ("stage_fd", "cia402"):
        run = CampaignRun(rig_of("microscope-ideal", layout), RIGS)
        run.ready()
        began[layout] = run.index
        assert run.cycle.state is State.READY
        run.asks = CommandKind.ACTIVATE
        run.tick()
        assert run.cycle.state is State.ACTIVE
    assert began["stage_fd"] < 100 < began["cia402"]


def test_a_rig_that_is_never_ready_is_told_so_and_not_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.studies.fault_campaign.checkpoints.PATIENCE", 50)
    with pytest.raises(RigError, match="microscope-ideal: not READY within 50 ticks; it is CONNECTED"):
        bring_to(rig_of("microscope-ideal", "cia402"), RIGS, READY)


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("bus.protocol=cia401", "bus.protocol"),
        ("safety.stop_s=7", "safety.stop_s"),
        ("axes.x.rated_force=2e5", "rated forces"),  # which no shared RPDO carries
    ],
)
def test_an_override_that_does_not_fit_is_refused_as_everywhere(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], override: str, says: str
) -> None:
    words = ["faults", str(RIGS / "microscope-ideal.toml"), "--set", "bus.protocol=cia402", "--set", override]
    monkeypatch.setattr("sys.argv", ["hil", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == EXIT_CONFIG
    assert says in capsys.readouterr().err


def cell(
    trial_name: str, point: Checkpoint, sabotage: Callable[[], None] = lambda: None, layout: str = "stage_fd"
) -> Cell:
    rig = rig_of("paper", layout)
    (trial,) = [trial for trial in TRIALS if trial.name == trial_name]
    run = bring_to(rig, RIGS, point)
    sabotage()
    return in_fork(lambda: run_cell(trial, point, 0, run))


ON_THE_WAY = active("approach", 1000)


def test_a_campaign_reruns_bit_for_bit() -> None:
    assert cell("encoder silent", ON_THE_WAY) == cell("encoder silent", ON_THE_WAY)


def never(*arguments: object, **keywords: object) -> None:
    return None


def react(patch: pytest.MonkeyPatch, fault: Fault, reaction: Reaction) -> None:
    changed = [reaction if number == fault else honest for number, honest in enumerate(REACTIONS)]
    patch.setattr("hil.cycle.fault_monitor.REACTIONS", changed)
    patch.setattr("hil.studies.fault_campaign.matrix.REACTIONS", changed)


Break = Callable[[pytest.MonkeyPatch], None]


def open_gate(self: TorqueGate, sequence: int, reset: bool = False) -> list[Frame]:
    return self.release(np.ones(2), np.zeros(2), permitted=True, sequence=sequence)


def unlimited(request: float, *others: object) -> float:
    return request


def always(*arguments: object) -> bool:
    return True


def accepted(*arguments: object) -> bool:
    return False


def reset_unasked(self: Supervisor, *, reset: bool) -> None:
    RECONNECT(self, reset=True)


RECONNECT = Supervisor._reconnect
NOT_SILENT = property(accepted, never)
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
        lambda m: m.setattr("hil.cycle.gate.limit_force", unlimited),
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
        "any jump is accepted",
        lambda m: m.setattr(FaultMonitor, "implausible", accepted),
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
        lambda m: m.setattr(DampedStop, "over", accepted),
        "operator stops",
        ON_THE_WAY,
        "STOPPING",
    ),
    (
        "R4 goes on sending",
        lambda m: m.setattr(Supervisor, "silent", NOT_SILENT, raising=False),
        "bus-off",
        ON_THE_WAY,
        "silence",
    ),
    (
        "a process that starts again resets the drives unasked",
        lambda m: m.setattr(Supervisor, "_reconnect", reset_unasked),
        "started again, the drives have tripped",
        ON_THE_WAY,
        "ended READY, expected CONNECTED",
    ),
]


@pytest.mark.requirement(id="SR-9.6")
@pytest.mark.replaces_methods
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


@pytest.mark.replaces_methods
def test_over_cia402_a_master_that_disables_nobody_fails_the_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    assert cell("operator stops", ON_THE_WAY, layout="cia402").passed
    outcome = cell(
        "operator stops", ON_THE_WAY, lambda: monkeypatch.setattr(Master, "_controlwords", never), layout="cia402"
    )
    assert not outcome.passed
    assert "enable 3 in READY" in outcome.why


@pytest.mark.requirement(id="SR-6.3")
@pytest.mark.replaces_methods
def test_a_drive_that_stays_enabled_fails_the_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its force is zero as it is told; it holds its brake open all the same."""

    def obey(self: ServoDrive, force: float, enable: bool, *rest: object) -> bool:
        return honest(self, force, True, *rest)  # type: ignore[arg-type]

    honest = ServoDrive.on_command
    outcome = cell("operator stops", ON_THE_WAY, lambda: monkeypatch.setattr(ServoDrive, "on_command", obey))
    assert "latched DRIVE_STAYS_ENABLED" in outcome.why
    monkeypatch.setattr(ServoDrive, "on_command", honest)

    def unseen() -> None:
        monkeypatch.setattr(ServoDrive, "on_command", obey)
        monkeypatch.setattr(FaultMonitor, "check_released", never)

    assert "READY, yet a drive is enabled" in cell("operator stops", ON_THE_WAY, unseen).why
