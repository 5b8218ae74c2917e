"""What the supervisor forgets on entering a state, and what it must not: waits, streaks, grants, the task's ranges."""

import pytest

from drivers.bus.counters import BusState, PortCounters
from hil.cycle.fault_table import Fault, Reaction
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind, LoadedTask, Tick
from hil.rig.file import load_rig
from tests.support.paths import RIGS
from tests.support.scripted_drives import Script, ScriptedDrives

READY, ENABLE = 5, 8  # ticks
WELL = Script()


def ready() -> ScriptedDrives:
    rig = ScriptedDrives(
        load_rig(
            RIGS / "paper.toml",
            [f"safety.ready_ticks={READY}", f"safety.enable_timeout_ticks={ENABLE}", "task.kind=hold"],
        )
    )
    until(rig, State.READY)
    return rig


def until(rig: ScriptedDrives, state: State, script: Script = WELL) -> int:
    """Ticks until it is there."""
    for count in range(1, 200):
        if rig.tick(script).state is state:
            return count
    raise AssertionError(f"{rig.cycle.state}, not {state}")


@pytest.mark.requirement(id="SR-5.1")
def test_a_reset_waits_for_well_axes_as_long_as_a_start_does() -> None:
    rig = ready()
    rig.tick(Script((CommandKind.ESTOP,)))
    assert rig.tick(Script((CommandKind.RESET,))).state is State.CONNECTED
    for _ in range(4 * READY):
        assert rig.tick(Script(silent=(1,))).state is State.CONNECTED, "one axis is not all of them"
    assert until(rig, State.READY) == READY


@pytest.mark.requirement(id="SR-2.1")
def test_a_press_of_stop_outlives_a_reset_of_the_same_tick() -> None:
    rig = ready()
    rig.tick(Script((CommandKind.ESTOP,)))
    rig.granted = {"estop": True}
    assert rig.tick(Script((CommandKind.RESET,))).state is State.ESTOP


@pytest.mark.requirement(id="SR-5.1")
def test_silence_outlives_milder_faults_and_ends_with_a_reset() -> None:
    rig = ready()
    supervisor, tick = rig.cycle.supervisor, Tick(9, 0, 0, PortCounters())
    supervisor.latch(Fault.BUS_OFF, Reaction.SILENT, tick)
    supervisor.latch(Fault.TRAVEL, Reaction.ZERO, tick)
    assert supervisor.silent
    assert supervisor.fault is Fault.BUS_OFF
    for _ in range(50):
        rig.tick()
    assert rig.tick(Script((CommandKind.RESET,))).state is State.CONNECTED
    assert not supervisor.silent


@pytest.mark.parametrize("command", [CommandKind.RESET, CommandKind.ACTIVATE])
def test_streaks_of_a_run_do_not_count_in_the_next(command: CommandKind) -> None:
    rig = ready()
    if command is CommandKind.RESET:
        rig.tick(Script((CommandKind.ESTOP,)))
    monitor = rig.cycle.monitor
    monitor._diverging = [19, 19]
    rig.tick(Script((command,)))
    assert monitor._diverging == [0, 0]


def test_each_activation_waits_for_the_drives_as_long_as_the_first() -> None:
    rig, deaf = ready(), Script(obeys=False)
    for _ in range(2):
        assert rig.tick(Script((CommandKind.ACTIVATE,), obeys=False)).state is State.ACTIVE
        for _ in range(ENABLE - 3):
            assert rig.tick(deaf).state is State.ACTIVE
        rig.tick(Script((CommandKind.STOP,), obeys=False))
        until(rig, State.READY, deaf)


def test_drives_that_were_enabled_are_asked_anew() -> None:
    rig = ready()
    rig.tick(Script((CommandKind.ACTIVATE,)))
    for _ in range(4):
        rig.tick()
    assert rig.cycle.supervisor.enabled
    rig.tick(Script((CommandKind.STOP,)))
    assert rig.cycle.supervisor._stopping_since_ns == rig._index * rig.rig.period_ns
    until(rig, State.READY)
    assert not rig.cycle.supervisor.enabled


def test_whichever_axis_moves_keeps_the_operator_waiting() -> None:
    supervisor = ready().cycle.supervisor
    assert not supervisor.guards.moves()
    for watch in supervisor._monitor.rest:
        watch.restless = True
        assert supervisor.guards.moves()
        watch.restless = False


def test_a_task_that_is_loaded_brings_its_own_ranges_and_is_loaded_at_rest_alone() -> None:
    rig = ready()
    supervisor = rig.cycle.supervisor
    task = LoadedTask(lambda _: None, [(-0.5, 0.5), (-0.25, 0.25)], "{}")
    load = Tick(99, 0, 0, PortCounters(), task=task)
    assert supervisor._load(CommandKind.LOAD_TASK, load)
    assert supervisor.start_ranges == [(-0.5, 0.5), (-0.25, 0.25)]
    supervisor.machine.state = State.ACTIVE
    assert not supervisor._load(CommandKind.LOAD_TASK, load)


def test_the_newest_activate_says_whether_to_hold() -> None:
    rig = ready()
    rig.tick(Script((CommandKind.ACTIVATE_HOLD,)))
    assert rig.cycle.commands.hold_asked
    rig.tick(Script((CommandKind.STOP,)))
    until(rig, State.READY)
    rig.tick(Script((CommandKind.ACTIVATE,)))
    assert not rig.cycle.commands.hold_asked


@pytest.mark.requirement(id="SR-5.1")
def test_a_bus_that_is_off_keeps_a_reset_from_being_taken() -> None:
    rig = ready()
    rig.tick(Script((CommandKind.ESTOP,)))
    assert rig.tick(Script((CommandKind.RESET,), bus=BusState.BUS_OFF)).state is State.ESTOP
