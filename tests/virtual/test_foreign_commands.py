"""Frames in the host's own name from another node, and two answers to one command: named at the first frame."""

from collections.abc import Callable

import pytest

from drivers.families.cia402.cia301 import NMT_ID, SDO_REQUEST_ID, SYNC_ID
from drivers.frame import Frame
from drivers.protocols.base import Command
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.rig.file import load_rig
from hil.rig.layout import host_layout
from hil.studies.fault_campaign.injections import answer_twice
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import RIGS

BEGIN = 650  # in ACTIVE


def run_at(tick: int, *sets: str) -> LockstepRun:
    run = LockstepRun(load_rig(RIGS / "paper.toml", sets), RIGS)
    while run.index < tick:
        run.tick()
    return run


def command(run: LockstepRun, ahead: int) -> list[Frame]:
    limits = [axis.limits.force for axis in run.rig.axes.values()]
    return host_layout(run.rig, RIGS).encode(Command(run.cycle.sent_sequence + ahead, limits, 3, False))


def settled(run: LockstepRun, frames: list[Frame], ticks: int = 4) -> LockstepRun:
    other = run.wire_of(0).attach("another node", None)
    for frame in frames:
        other.send(frame, run.wire.now_ns + 400_000)
    for _ in range(ticks):
        run.tick()
    return run


@pytest.mark.requirement(id="SR-3.5")
@pytest.mark.parametrize("layout", ["stage_fd", "stage_classic", "cia402"])
@pytest.mark.parametrize("tick", [3, 400, BEGIN], ids=["CONNECTED", "READY", "ACTIVE"])
@pytest.mark.parametrize("ahead", [0, 1])
def test_one_command_of_another_node_latches_and_says_its_identifier(layout: str, tick: int, ahead: int) -> None:
    run = run_at(tick, f"bus.protocol={layout}")
    if tick == 400:  # an operator activates as soon as it is ready: stop that
        run = LockstepRun(run.rig, RIGS, operator=lambda run, index: ())
        while run.cycle.state is not State.READY:
            run.tick()
    frames = command(run, ahead)
    found: list[float] = []
    other = run.wire_of(0).attach("another node", None)
    for frame in frames:
        other.send(frame, run.wire.now_ns + 400_000)
    for _ in range(4):
        run.tick()
        found += [e.value for e in run.cycle.monitor.evidence if e.fault == Fault.FOREIGN_COMMAND]
    assert (run.cycle.fault, run.cycle.state) == (Fault.FOREIGN_COMMAND, State.FAULT)
    assert set(found) <= {float(frame.can_id) for frame in frames}
    run.tick()
    assert not any(run.stage.applied_force)


@pytest.mark.parametrize(
    ("frame", "fault"),
    [
        (Frame(SYNC_ID, b""), Fault.FOREIGN_COMMAND),
        (Frame(NMT_ID, b"\x02\x01"), Fault.FOREIGN_COMMAND),
        (Frame(SDO_REQUEST_ID + 1, b"\x40\x00\x10\x00\0\0\0\0"), Fault.NONE),  # another tool reads 1000h
        (Frame(0x321, b"\x00"), Fault.NONE),
    ],
)
def test_of_a_canopen_master_sync_and_nmt_are_the_hosts_and_sdo_is_anybodys(frame: Frame, fault: Fault) -> None:
    assert settled(run_at(BEGIN, "bus.protocol=cia402"), [frame]).cycle.fault is fault


def test_our_own_frames_given_back_by_the_bus_are_no_ones_else() -> None:
    run = run_at(BEGIN, "bus.protocol=cia402")
    assert run.cycle.monitor.named_counts()["foreign_command"] == 0


def forged(change: Callable[[LockstepRun], None], *sets: str) -> LockstepRun:
    run = run_at(BEGIN, *sets)
    change(run)
    run.tick()
    return run


@pytest.mark.requirement(id="SR-3.5")
@pytest.mark.parametrize("layout", ["stage_fd", "stage_classic"])
def test_two_answers_that_differ_are_both_dropped_and_named(layout: str) -> None:
    run = forged(lambda run: answer_twice(run, 1, 0), f"bus.protocol={layout}")
    assert run.cycle.fault is Fault.ANSWERS_DIFFER
    assert run.cycle.inbox.fresh == [True, False]


def test_the_same_answer_twice_is_what_can_may_do() -> None:
    run = forged(lambda run: run.received.extend(run.received))
    assert run.cycle.fault is Fault.NONE
    assert all(run.cycle.inbox.fresh)


@pytest.mark.requirement(id="SR-3.5")
def test_what_a_checksum_has_passed_is_never_forgiven() -> None:
    """An old answer of the axis once in a while: with a leak for line noise it would be nothing for ever."""
    run = run_at(BEGIN, "task.kind=hold")
    old = list(run.received)
    for _ in range(run.rig.safety.bad_frame_limit):
        for _ in range(3 * run.rig.safety.bad_frame_leak_ticks // 2):
            run.tick()
        assert run.cycle.fault is Fault.NONE
        run.received.append(old[0])
        run.tick()
    assert run.cycle.fault is Fault.BAD_FRAMES
