"""Limit switches: what closes stops the axis, no force goes beyond, and a reset leads back inside."""

from collections.abc import Sequence

import pytest

from drivers.protocols.base import DriveStatus
from hil.cycle.fault_table import Fault
from hil.cycle.gate import ForceLimits, TorqueGate
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.rig.schema import RigError
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import RIGS

SWITCHES = ["axes.x.limits.switches=true", 'plant.switches=[{axis="x",low=-0.02,high=0.02}]']


def run_of(*sets: str, operator: object = None) -> LockstepRun:
    rig = load_rig(RIGS / "paper.toml", [*SWITCHES, *sets])
    return LockstepRun(rig, RIGS, operator=operator) if operator else LockstepRun(rig, RIGS)  # type: ignore[arg-type]


def until_fault(run: LockstepRun, ticks: int = 2000) -> None:
    while not run.cycle.fault:
        run.tick()
        assert run.index < ticks


@pytest.mark.requirement(id="SR-4.1")
@pytest.mark.parametrize("sets", [(), ("axes.x.direction=-1",)])
def test_an_axis_that_runs_onto_a_switch_is_stopped_and_the_switch_named(sets: Sequence[str]) -> None:
    run = run_of(*sets)
    until_fault(run)
    assert run.cycle.fault is Fault.LIMIT_SWITCH
    (evidence,) = run.cycle.monitor.armed_evidence()
    assert (evidence.axis, evidence.value) == (0, 0.0 if run.true_position[0] < 0 else 1.0)
    assert 0.02 <= abs(run.true_position[0]) < 0.0205
    while run.cycle.state is not State.FAULT:
        run.tick()


def test_from_a_switch_a_reset_leads_to_ready_and_it_does_not_latch_again_until_it_has_opened() -> None:
    asked: list[CommandKind] = []

    def operator(run: LockstepRun, index: int) -> Sequence[CommandKind]:
        if run.cycle.state is State.READY and run.activated_at < 0:
            return [CommandKind.ACTIVATE]
        return [asked.pop()] if asked else []

    run = run_of("axes.x.limits.standstill=1.0", operator=operator)  # so that READY lets it be pushed
    until_fault(run)
    while run.cycle.state is not State.FAULT:
        run.tick()
    asked.append(CommandKind.RESET)
    for _ in range(400):
        run.tick()
    assert (run.cycle.state, run.cycle.fault) == (State.READY, Fault.NONE)
    assert run.cycle.monitor.closed[0]
    inward = 1.0 if run.true_position[0] < 0 else -1.0
    run.stage.push(0, 30.0 * inward)
    while run.cycle.monitor.closed[0]:
        run.tick()
    run.stage.push(0, -90.0 * inward)
    until_fault(run, run.index + 1000)
    assert run.cycle.fault is Fault.LIMIT_SWITCH, "closed anew"


@pytest.mark.requirement(id="SR-4.1")
def test_a_switch_that_is_closed_lets_only_force_inwards_pass() -> None:
    run = run_of()
    gate = TorqueGate(run.cycle.protocol, [ForceLimits(2.0, -1.0, 1.0, 5.0)] * 2)

    def passed(force: float) -> list[float]:
        gate.release([force, force], [0.0, 0.0], permitted=True, sequence=1)
        return gate.force

    assert passed(1.5) == [1.5, 1.5]
    gate.block(0, low=False, high=True)
    assert (passed(1.5), passed(-1.5)) == ([0.0, 1.5], [-1.5, -1.5])
    gate.block(0, low=True, high=False)
    assert (passed(1.5), passed(-1.5)) == ([1.5, 1.5], [0.0, -1.5])
    gate.block(0, low=False, high=False)
    assert passed(-1.5) == [-1.5, -1.5]


def test_while_homing_the_switch_that_the_axis_homes_on_is_no_fault_and_the_other_one_is() -> None:
    run = run_of('axes.x.home={by="limit",direction=-1,farthest=1.0}')
    monitor, inbox = run.cycle.monitor, run.cycle.inbox
    for _ in range(20):
        run.tick()
    for bit, homing, seen in (
        (DriveStatus.LIMIT_LOW, True, False),
        (DriveStatus.LIMIT_LOW, False, False),  # still closed: it homed there
        (DriveStatus(0), False, False),
        (DriveStatus.LIMIT_LOW, False, True),
        (DriveStatus.LIMIT_HIGH, True, True),
    ):
        sample = inbox.samples[0]
        assert sample is not None
        sample.status = int(bit)
        monitor.begin()
        monitor.check_switches(inbox, homing=homing)
        assert bool(monitor.active >> Fault.LIMIT_SWITCH & 1) is seen, (bit, homing)


@pytest.mark.parametrize("layout", ["stage_classic", "cia402"])
def test_a_layout_without_room_for_switches_is_refused_when_the_file_is_read(layout: str) -> None:
    with pytest.raises(RigError) as refused:
        load_rig(RIGS / "paper.toml", [*SWITCHES, f"bus.protocol={layout}"])
    assert f"'{layout}'" in str(refused.value)
    assert "axes.x.limits.switches" in str(refused.value)


def test_a_home_switch_is_asked_of_the_layout_too() -> None:
    home = 'axes.y.home={by="switch",direction=1,farthest=1.0}'
    load_rig(RIGS / "paper.toml", [home])
    with pytest.raises(RigError, match=r"axes\.y\.home\.by"):
        load_rig(RIGS / "paper.toml", [home, "bus.protocol=stage_classic"])


def test_drives_whose_switches_nobody_asked_for_say_nothing() -> None:
    rig = load_rig(RIGS / "paper.toml", SWITCHES[1:])
    run = LockstepRun(rig, RIGS)
    for _ in range(800):
        run.tick()
    assert not run.cycle.fault
