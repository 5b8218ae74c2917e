"""Rows of the fault table that need more than an injection: grants, heartbeats, the age and number of a command."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest

from drivers.protocols.base import DriveStatus
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.step import ControlCycle
from hil.cycle.tick import CommandKind, OperatorCommand
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.virtual.invariants import Invariants
from hil.virtual.lockstep import LockstepRun
from sim_plant.scenario.language import Scenario
from tests.support.paths import RIGS

READY_BY = 60  # ticks
LATER_NS = 2**62
Mail = Callable[["Posted", int], Sequence[OperatorCommand]]


class Posted(LockstepRun):
    """A run whose commands are exactly those of `mail(run, now_ns)`."""

    def __init__(self, rig: RigConfig, mail: Mail, scenario: Scenario | None = None) -> None:
        super().__init__(rig, RIGS, observer=Invariants(rig, RIGS).observe, scenario=scenario)
        self._mail = mail

    def _commands(self, now: int) -> tuple[OperatorCommand, ...]:
        return tuple(self._mail(self, now))

    def go(self, ticks: int) -> "Posted":
        for _ in range(ticks):
            self.tick()
        return self


def paper(*overrides: str) -> RigConfig:
    return load_rig(RIGS / "paper.toml", overrides)


def activate_once(*, expires_ns: int = LATER_NS) -> Mail:
    def mail(run: Posted, now: int) -> list[OperatorCommand]:
        return [OperatorCommand(CommandKind.ACTIVATE, 1, expires_ns)] if run.index == READY_BY else []

    return mail


@pytest.mark.requirement(id="SR-5.4")
@pytest.mark.parametrize(
    ("grant", "strict", "lenient"),
    [
        ("realtime_ok", "timing.allow_degraded=false", "timing.allow_degraded=true"),
        ("recorder_ok", "telemetry.recording_required=true", "telemetry.recording_required=false"),
    ],
)
def test_what_was_not_granted_refuses_activate_unless_the_rig_says_otherwise(
    grant: str, strict: str, lenient: str
) -> None:
    for override, expected in ((strict, State.READY), (lenient, State.ACTIVE)):
        run = Posted(paper(override), activate_once())
        run.grants[grant] = False
        run.go(READY_BY + 5)
        assert run.cycle.state is expected
        assert run.cycle.commands.refused == (expected is State.READY)


@pytest.mark.requirement(id="SR-5.4")
def test_a_rig_file_changed_on_disk_refuses_activate_and_leaves_a_running_task_alone() -> None:
    changed = Posted(paper(), activate_once())
    changed.grants["rig_ok"] = False
    assert changed.go(READY_BY + 5).cycle.state is State.READY
    running = Posted(paper(), activate_once()).go(READY_BY + 5)
    running.grants["rig_ok"] = False
    assert running.go(50).cycle.state is State.ACTIVE


def test_a_recorder_lost_while_active_stops_nothing_and_is_counted() -> None:
    run = Posted(paper("telemetry.recording_required=true"), activate_once()).go(READY_BY + 5)
    run.grants["recorder_ok"] = False
    assert run.go(50).cycle.state is State.ACTIVE
    assert run.cycle.monitor.counts[Fault.RECORDER_LOST] == 50


@pytest.mark.requirement(id="SR-5.4")
def test_a_recorder_has_a_second_to_begin_in_which_it_is_not_lost_but_activate_is_refused() -> None:
    rig = paper("telemetry.recording_required=true")
    run = Posted(rig, activate_once())
    run.grants["recorder_ok"] = False
    assert run.go(round(rig.rate_hz)).cycle.state is State.READY
    assert run.cycle.monitor.counts[Fault.RECORDER_LOST] == 0
    run.go(1)
    assert run.cycle.monitor.counts[Fault.RECORDER_LOST] == 1


def test_a_recorder_that_was_there_is_lost_in_the_tick_without_it() -> None:
    run = Posted(paper(), activate_once()).go(1)
    run.grants["recorder_ok"] = False
    run.go(READY_BY)
    assert run.cycle.monitor.counts[Fault.RECORDER_LOST] == READY_BY


HEARTBEAT_TICKS = 40


def heartbeats(until: int) -> Mail:
    """One every ten ticks before tick `until`; ACTIVATE in between."""

    def mail(run: Posted, now: int) -> list[OperatorCommand]:
        if run.index == READY_BY:
            return [OperatorCommand(CommandKind.ACTIVATE, run.index, LATER_NS)]
        beat = run.index % 10 == 5 and run.index < until
        return [OperatorCommand(CommandKind.HEARTBEAT, run.index, LATER_NS)] if beat else []

    return mail


@pytest.mark.requirement(id="SR-2.3")
def test_without_the_operators_heartbeat_activate_is_refused() -> None:
    rig = paper(f"safety.heartbeat_s={HEARTBEAT_TICKS * 1e-3}")
    assert Posted(rig, heartbeats(until=0)).go(READY_BY + 5).cycle.state is State.READY
    assert Posted(rig, heartbeats(until=10)).go(READY_BY + 5).cycle.state is State.READY, "one that is too old"
    assert Posted(rig, heartbeats(until=READY_BY)).go(READY_BY + 5).cycle.state is State.ACTIVE


@pytest.mark.requirement(id="SR-2.3")
def test_a_heartbeat_that_ends_brings_a_damped_stop_in_time_and_latches() -> None:
    rig = paper(f"safety.heartbeat_s={HEARTBEAT_TICKS * 1e-3}")
    last = 205
    run = Posted(rig, heartbeats(until=last + 1)).go(last + HEARTBEAT_TICKS + 1)
    assert run.cycle.state is State.ACTIVE, "no sooner than was agreed"
    run.go(1)
    assert run.cycle.fault is Fault.HEARTBEAT_LOST
    (lost,) = [one for one in run.cycle.monitor.evidence if one.fault == Fault.HEARTBEAT_LOST]
    assert lost.limit < lost.value < lost.limit + 2e-3
    assert run.cycle.state is State.STOPPING
    run.go(round(rig.safety.stop_s * 1e3) + 3)
    assert run.cycle.state is State.FAULT
    assert run.stage.applied_force == [0.0, 0.0]


def test_before_its_first_tick_a_cycle_is_in_boot_without_a_fault() -> None:
    cycle = ControlCycle(paper(), RIGS)
    assert (cycle.state, cycle.fault, cycle.silent) == (State.BOOT, Fault.NONE, False)


@pytest.mark.requirement(id="SR-5.3")
def test_a_stale_command_is_refused_and_the_same_one_in_time_is_not() -> None:
    now_ns = READY_BY * 1_000_000
    assert Posted(paper(), activate_once(expires_ns=now_ns - 1)).go(READY_BY + 5).cycle.state is State.READY
    assert Posted(paper(), activate_once(expires_ns=now_ns)).go(READY_BY + 5).cycle.state is State.ACTIVE


@pytest.mark.requirement(id="SR-5.3")
def test_a_replayed_activate_does_not_start_the_stage_a_second_time() -> None:
    activate = OperatorCommand(CommandKind.ACTIVATE, 1, LATER_NS)
    story = {READY_BY: activate, 100: OperatorCommand(CommandKind.STOP, 2, LATER_NS), 200: activate}
    run = Posted(paper(), lambda run, now: [story[run.index]] if run.index in story else []).go(250)
    assert run.cycle.state is State.READY
    assert run.cycle.commands.refused == 1


@pytest.mark.requirement(id="SR-3.4")
@pytest.mark.parametrize("jump_s", [0.5, 0.002, -0.002, -0.5])
def test_a_drives_clock_that_jumps_keeps_the_stage_on_its_task_or_stops_it(jump_s: float) -> None:
    jump = {"kind": "clock_jump", "axis": "x", "at_tick": 400, "value": jump_s}
    run = Posted(paper(), activate_once(), Scenario.model_validate({"fault": [jump]})).go(400)
    limit = run.rig.axes["x"].limits.following_error
    for _ in range(300):
        run.tick()
        if run.cycle.state is State.ACTIVE:
            assert abs(float(run.true_position[0] - run.cycle.inputs[0].sample.position)) < limit
        else:
            assert run.cycle.fault is not Fault.NONE
    assert run.cycle.state in (State.ACTIVE, State.FAULT)


@pytest.mark.requirement(id="SR-4.3")
def test_a_push_stronger_than_the_drive_is_a_following_error_and_ends_at_zero() -> None:
    push = {"kind": "push", "axis": "x", "at_tick": 300, "value": 8.0}
    run = Posted(paper(), activate_once(), Scenario.model_validate({"fault": [push]})).go(400)
    assert run.cycle.fault in (Fault.FOLLOWING_ERROR, Fault.SPEED)
    assert run.cycle.state is State.FAULT
    assert run.stage.applied_force == [0.0, 0.0]


@pytest.mark.requirement(id="SR-1.4")
@pytest.mark.parametrize("error", [ZeroDivisionError, OverflowError])
def test_a_law_whose_arithmetic_fails_is_answered_as_one_that_asks_for_nan(error: type[ArithmeticError]) -> None:
    run = Posted(paper(), activate_once()).go(200)
    assert run.cycle.state is State.ACTIVE

    class Failing:
        denominator_floors = 0

        def reset(self, *_: object) -> None: ...

        def force(self, axes: object) -> list[float]:
            raise error

    run.cycle.law = Failing()
    run.tick()
    assert run.cycle.state is State.FAULT
    assert run.cycle.fault is Fault.NOT_FINITE
    assert run.cycle.gate.force == [0.0, 0.0]


@pytest.mark.requirement(id="SR-6.3")
def test_a_drive_that_ignores_its_enable_bit_is_left_to_its_own_watchdog() -> None:
    """Its torque is zero as it is told, but enabled it holds its brake open; only silence makes it close."""

    def mail(run: Posted, now: int) -> list[OperatorCommand]:
        said = {READY_BY: CommandKind.ACTIVATE, 100: CommandKind.STOP, 300: CommandKind.RESET}.get(run.index)
        return [] if said is None else [OperatorCommand(said, run.index, LATER_NS)]

    run = Posted(paper(), mail).go(160)
    assert run.cycle.state is State.READY
    run.stage.drives[0].stuck = True
    run.go(run.rig.safety.disable_timeout_ticks)
    assert run.stage.drives[0].status & DriveStatus.ENABLED
    assert run.cycle.state is State.READY
    run.go(20)
    assert (run.cycle.state, run.cycle.fault) == (State.FAULT, Fault.DRIVE_STAYS_ENABLED)
    assert [drive.status & DriveStatus.ENABLED for drive in run.stage.drives] == [0, 0]
    run.stage.drives[0].stuck = False
    assert run.go(150).cycle.state is State.READY  # a reset clears it once the drive obeys again


@pytest.mark.requirement(id="SR-6.1")
def test_a_drive_that_never_enables_ends_the_activation_in_time_and_latches() -> None:
    rig = paper("safety.enable_timeout_ticks=40")
    run = Posted(rig, activate_once())
    bare = run.stage.drives[0]
    bare.taps.append(lambda sample: replace(sample, status=sample.status & ~int(DriveStatus.ENABLED)))
    run.go(READY_BY + 39)
    assert run.cycle.state is State.ACTIVE
    assert run.cycle.setpoints.task_ns < 0, "no task begins before every drive is enabled"
    run.go(1)
    assert (run.cycle.state, run.cycle.fault) == (State.FAULT, Fault.ENABLE_TIMEOUT)
    assert run.cycle.gate.force == [0.0, 0.0]


def test_an_operator_who_resets_again_and_again_does_not_hold_up_the_reset() -> None:
    def mail(run: Posted, now: int) -> list[OperatorCommand]:
        return [OperatorCommand(CommandKind.RESET, run.index, LATER_NS)] if 100 <= run.index < 130 else []

    run = Posted(paper(), mail).go(99)
    run.stage.drives[0].trip(run.stage.now_ns)
    run.go(51)
    assert run.cycle.state is State.READY
    assert not run.stage.drives[0].status & DriveStatus.WATCHDOG


@pytest.mark.requirement(id="SR-6.2")
@pytest.mark.long
@pytest.mark.parametrize("protocol", ["stage_fd", "stage_classic", "cia402"])
@pytest.mark.parametrize("first_slot", [0, 7])
def test_a_restarted_process_leaves_to_the_operator_what_the_drives_latched(protocol: str, first_slot: int) -> None:
    """Also one whose first tick is late: its number is not 0, as slots are numbered from the start on."""

    def mail(run: Posted, now: int) -> list[OperatorCommand]:
        return [OperatorCommand(CommandKind.RESET, run.index, LATER_NS)] if run.index == 1500 else []

    run = Posted(paper(f"bus.protocol={protocol}"), mail)
    for drive in run.stage.drives:
        drive.trip(0)
    run.skip(first_slot)
    while run.index < 1500:
        assert run.go(1).cycle.state is State.CONNECTED
    assert run.go(1500).cycle.state is State.READY


@pytest.mark.requirement(id="SR-6.1")
@pytest.mark.parametrize("axis", [0, 1])
def test_one_drive_that_is_not_well_keeps_the_whole_rig_from_ready(axis: int) -> None:
    run = Posted(paper(), lambda run, now: [])
    run.stage.drives[axis].trip(0)
    assert run.go(3 * READY_BY).cycle.state is State.CONNECTED
    assert [bool(drive.status & DriveStatus.WATCHDOG) for drive in run.stage.drives] == [axis == 0, axis == 1]


@pytest.mark.parametrize("from_tick", [0, 10], ids=["ever", "any more"])
def test_one_drive_that_says_nothing_keeps_the_whole_rig_from_ready(from_tick: int) -> None:
    silent = {"kind": "encoder_silent", "axis": "y", "at_tick": from_tick}
    run = Posted(paper(), activate_once(), Scenario.model_validate({"fault": [silent]}))
    assert run.go(3 * READY_BY).cycle.state is State.CONNECTED
    heard = [sample is not None for sample in run.cycle.inbox.samples]
    assert heard == [True, from_tick > 0]
