"""The stop line in lockstep: in every state it reaches it means ESTOP, zero torque in the same tick, and it replays."""

from pathlib import Path

import pytest

from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.lockstep import LockstepRun, activate_when_ready
from hil.virtual.replay import replay_run
from tests.support.paths import ROOT

RIG = ROOT / "deploy" / "rigs" / "paper.toml"
LONG = 3000  # ticks within which every state below is reached


def run_to(state: State) -> LockstepRun:
    """A run that has just reached `state`, by an operator who asks for whatever leads there."""

    def operator(run: LockstepRun, index: int) -> list[CommandKind]:
        if run.cycle.state is State.READY:
            return [CommandKind.HOME if state is State.HOMING else CommandKind.ACTIVATE]
        return [CommandKind.STOP] if state is State.STOPPING and run.cycle.state is State.ACTIVE else []

    run = LockstepRun(load_rig(RIG), RIG.parent, operator=operator if state is not State.READY else lambda *_: ())
    for _ in range(LONG):
        if run.cycle.state is state:
            return run
        if state is State.FAULT and run.cycle.state is State.ACTIVE:
            run.stage.drives[0].fail()
        run.tick()
    raise AssertionError(f"{state.name} was not reached")


@pytest.mark.requirement(id="SR-2.1")
@pytest.mark.parametrize(
    "state", [State.BOOT, State.CONNECTED, State.READY, State.HOMING, State.ACTIVE, State.STOPPING, State.FAULT]
)
def test_from_every_state_it_leads_to_estop_with_zero_torque_in_the_same_tick(state: State) -> None:
    run = run_to(state)
    run.estop = True
    result = run.tick()
    assert run.cycle.state is State.ESTOP
    assert result.frames
    assert list(result.record["force"]) == [0.0] * 4
    assert int(result.record["flags"]) & 32
    for _ in range(200):  # the operator goes on asking, to no avail
        assert not run.tick().record["force"].any()
    assert run.cycle.state is State.ESTOP
    assert not run.stage.applied_force[0]
    assert not int(run.tick().record["flags"]) & 32  # for one tick only


def test_a_press_is_recorded_and_replayed_byte_for_byte(tmp_path: Path) -> None:
    rig = load_rig(RIG)
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, RIG)
    run = LockstepRun(rig, RIG.parent, operator=activate_when_ready, observer=recorder.observe)
    for tick in range(300):
        run.estop = tick == 200
        run.tick()
    recorder.close()
    assert run.cycle.state is State.ESTOP
    report = replay_run(tmp_path / "run.mcap")
    assert (report.ticks, report.different) == (300, 0)


def test_after_shutdown_a_press_is_refused_and_counted() -> None:
    run = run_to(State.READY)
    run.stop = True
    run.tick()
    assert run.cycle.state is State.SHUTDOWN
    run.estop = True
    assert run.tick().frames == []
    assert run.cycle.state is State.SHUTDOWN


@pytest.mark.requirement(id="SR-2.1")
def test_a_reset_in_the_same_tick_does_not_undo_it() -> None:
    run = LockstepRun(load_rig(RIG), RIG.parent, operator=lambda run, _: [CommandKind.RESET, CommandKind.ACTIVATE])
    for _ in range(100):
        run.estop = True
        run.tick()
        assert run.cycle.state is State.ESTOP
