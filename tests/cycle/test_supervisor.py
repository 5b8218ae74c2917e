"""The supervisor at its exact numbers: how many ticks each state waits, what may begin where, what a reset sends."""

import math

import pytest

from drivers.bus.counters import BusState, PortCounters
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.step import ControlCycle
from hil.cycle.supervisor import RESET_TICKS
from hil.cycle.tick import CommandKind, Tick
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from tests.support.paths import RIGS
from tests.support.scripted_drives import Script, ScriptedDrives

READY, ENABLE = 5, 8  # ticks
QUICK = [f"safety.ready_ticks={READY}", f"safety.enable_timeout_ticks={ENABLE}", "task.kind=hold"]


def paper(*overrides: str) -> RigConfig:
    return load_rig(RIGS / "paper.toml", [*QUICK, *overrides])


def drives() -> ScriptedDrives:
    return ScriptedDrives(paper())


def ticks_until(rig: ScriptedDrives, state: State) -> int:
    for count in range(1, 200):
        if rig.tick().state is state:
            return count
    raise AssertionError(f"{rig.cycle.state}, not {state}")


def test_all_axes_have_to_be_well_for_so_many_ticks_in_a_row() -> None:
    rig = drives()
    assert rig.tick().state is State.CONNECTED  # its frame is the first that drives can answer
    for _ in range(READY - 1):
        assert rig.tick().state is State.CONNECTED
    assert rig.tick(Script(silent=(1,))).state is State.CONNECTED
    assert ticks_until(rig, State.READY) == READY, "from the start again"


@pytest.mark.parametrize("bus", [BusState.ERROR_ACTIVE, BusState.ERROR_PASSIVE, BusState.BUS_OFF])
def test_a_bus_that_is_off_keeps_it_from_ready(bus: BusState) -> None:
    cycle = ControlCycle(paper(), RIGS)
    cycle.supervisor.advance(Tick(0, 0, 0, PortCounters()))
    assert cycle.state is State.CONNECTED
    rig = drives()
    rig.tick()
    rig.tick()
    rig.cycle.supervisor._ready_ticks = READY - 1
    rig.cycle.supervisor._progress(Tick(9, 0, 0, PortCounters(state=bus)))
    assert (rig.cycle.state is State.READY) is (bus <= BusState.ERROR_PASSIVE)


@pytest.mark.parametrize("late", [0, 1])
def test_drives_have_so_many_ticks_to_say_that_they_apply_torque(late: int) -> None:
    rig = drives()
    ticks_until(rig, State.READY)
    assert rig.tick(Script((CommandKind.ACTIVATE,), obeys=False)).state is State.ACTIVE
    for _ in range(ENABLE - 2 + late):
        shown = rig.tick(Script(obeys=False))
    if late:
        assert (shown.state, shown.fault) == (State.FAULT, Fault.ENABLE_TIMEOUT)
        return
    assert (shown.state, shown.fault) == (State.ACTIVE, Fault.NONE)
    assert rig.tick().state is State.ACTIVE
    assert rig.cycle.supervisor.enabled


def test_a_reset_is_told_to_the_drives_as_an_edge_that_outlives_lost_frames() -> None:
    rig = drives()
    ticks_until(rig, State.READY)
    rig.tick(Script((CommandKind.ESTOP,)))
    told = []
    for tick in range(4 * RESET_TICKS):
        impatient = tick == RESET_TICKS + 1
        shown = rig.tick(Script((CommandKind.ESTOP, CommandKind.RESET) if tick == 0 or impatient else ()))
        assert shown.command is not None
        told.append(bool(shown.command.reset))
    assert RESET_TICKS == 3
    assert told == [False] * 3 + [True] * 3 + [False] * 6, "an impatient operator does not hold it up"


@pytest.mark.requirement(id="SR-4.4")
def test_a_task_may_begin_at_both_ends_of_its_ranges_and_not_beyond() -> None:
    cycle = ControlCycle(paper(), RIGS)
    supervisor = cycle.supervisor
    (low_x, high_x), (low_y, high_y) = supervisor.start_ranges = [(-0.25, 0.5), (-0.125, 0.375)]
    for x, y, may in (
        (low_x, low_y, True),
        (high_x, high_y, True),
        (math.nextafter(low_x, -1.0), 0.0, False),
        (math.nextafter(high_x, 1.0), 0.0, False),
        (0.0, math.nextafter(low_y, -1.0), False),
        (0.0, math.nextafter(high_y, 1.0), False),
        (math.nan, 0.0, False),
    ):
        cycle.axes.measured = [x, y]
        assert supervisor.guards.within(supervisor.start_ranges) is may, (x, y)


def test_a_heartbeat_counts_up_to_its_age_and_not_a_nanosecond_longer() -> None:
    cycle = ControlCycle(paper("safety.heartbeat_s=0.5"), RIGS)
    supervisor = cycle.supervisor
    for heard, now, may in ((None, 0, False), (0, 500_000_000, True), (7, 500_000_007, True), (7, 500_000_008, False)):
        supervisor.commands.heartbeat_ns = heard
        assert supervisor.guards.may_activate(Tick(1, now, now, PortCounters())) is may, (heard, now)


@pytest.mark.requirement(id="SR-5.4")
@pytest.mark.parametrize(
    ("missing", "overrides", "may"),
    [
        ("rig_ok", [], False),
        ("recorder_ok", ["telemetry.recording_required=true"], False),
        ("recorder_ok", ["telemetry.recording_required=false"], True),
        ("realtime_ok", ["timing.allow_degraded=false"], False),
        ("realtime_ok", ["timing.allow_degraded=true"], True),
    ],
)
def test_what_keeps_an_operator_from_activating(missing: str, overrides: list[str], may: bool) -> None:
    supervisor = ControlCycle(paper(*overrides), RIGS).supervisor
    assert supervisor.guards.may_activate(Tick(1, 0, 0, PortCounters()))
    assert supervisor.guards.may_activate(Tick(1, 0, 0, PortCounters(), **{missing: False})) is may  # type: ignore[arg-type]


def test_after_a_reset_every_axis_is_to_be_heard_anew_before_its_position_counts() -> None:
    rig = drives()
    ticks_until(rig, State.READY)
    rig.tick(Script((CommandKind.ESTOP,)))
    assert (rig.cycle.inbox.heard, rig.cycle.sampling.tracked) == ([True, True], True)
    rig.tick(Script((CommandKind.RESET,), silent=(1,)))
    for _ in range(3):
        rig.tick(Script(silent=(1,)))
        assert (rig.cycle.inbox.heard, rig.cycle.sampling.tracked) == ([True, False], False)
    rig.tick()
    assert (rig.cycle.inbox.heard, rig.cycle.sampling.tracked) == ([True, True], True)
