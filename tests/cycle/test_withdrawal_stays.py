"""WITHDRAW: where the tip must not move, it stays, and words say how to lead it out."""

from collections.abc import Callable

import pytest

from drivers.protocols.base import DriveStatus
from drivers.wire.faults import FaultKind, WireFault
from hil.cycle.fault_table import Fault
from hil.cycle.goal import Goal, GoalKind, MotionWord
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.events.table import Kind
from tests.support.tip import INSIDE, SAFE, TipRun, X, Z, down


def test_a_fault_of_the_axis_itself_is_for_the_damped_stop_and_words_lead_the_tip_out() -> None:
    rig = TipRun(down, "axes.z.limits.switches=true").to(-0.0015)
    rig.says = [CommandKind.STOP]
    rig.ticks(60)
    assert rig.words[-1] == MotionWord.WITHDRAW
    rig.shows(Z, DriveStatus.LIMIT_LOW)
    assert rig.rests() < 60
    assert rig.run.cycle.fault is Fault.LIMIT_SWITCH
    assert not rig.is_out()
    (line,) = rig.lines(Kind.TIP)
    assert "z is beyond its safe height of -0.001; next: hil command microscope-ideal reset, then" in line
    assert "hil move microscope-ideal z=-0.001" in line


@pytest.mark.parametrize("axis", [X, Z])
def test_without_samples_nothing_is_led_anywhere(axis: int) -> None:
    rig = TipRun().to(-0.0015)
    rig.run.wire.inject(WireFault(FaultKind.DROP, from_ns=rig.run.wire.now_ns, node=rig.rig.axis_names[axis]))
    rig.rests()
    assert rig.run.cycle.fault is Fault.ENCODER_LOST
    assert MotionWord.WITHDRAW not in rig.words
    assert not rig.is_out()


STAYS: dict[str, Callable[[TipRun], None]] = {
    "emergency stop": lambda rig: rig.says.append(CommandKind.ESTOP),
    "stop line": lambda rig: setattr(rig.run, "estop", True),
    "drive fault": lambda rig: rig.run.stage.drives[X].fail(),
}


@pytest.mark.parametrize("happens", STAYS.values(), ids=STAYS)
@pytest.mark.parametrize("on_its_way_out", [False, True])
def test_the_tip_stays_where_nothing_may_move_and_the_words_lead_it_back(
    happens: Callable[[TipRun], None], on_its_way_out: bool
) -> None:
    """As the words say: reset, activate-hold, and a move to the safe height."""
    rig = TipRun().to(-0.0018)
    if on_its_way_out:
        rig.says = [CommandKind.STOP]
        rig.ticks(50)
    happens(rig)
    rig.ticks(20)
    assert rig.state in (State.FAULT, State.ESTOP)
    assert not any(rig.rows[-1]["force"])
    assert MotionWord(rig.words[-1]) is MotionWord.NONE
    assert not rig.is_out()
    said = rig.run.cycle.tip
    assert said.startswith("the tip may be in a cell: z is beyond its safe height of -0.001; lead it out: ")
    if rig.run.stage.drives[X].status & DriveStatus.FAULT:
        return
    rig.says = [CommandKind.RESET]
    rig.becomes_ready()
    assert rig.run.cycle.tip == said
    rig.ticks(300).says = [CommandKind.HOME]
    rig.ticks(2)
    assert rig.state is State.READY, "home would take the tip across"
    rig.says = [CommandKind.ACTIVATE_HOLD]
    while rig.words[-1] != MotionWord.HOLD:
        rig.ticks(1)
    assert rig.run.cycle.tip == "", "an axis under torque is on its way, and not left"
    rig.run.goals.append(Goal(1, GoalKind.MOVE, mask=1 << Z, position=(0.0, 0.0, SAFE, 0.0)))
    rig.ticks(300)
    rig.says = [CommandKind.STOP]
    rig.rests()
    assert rig.run.cycle.tip == ""
    rig.ticks(300).says = [CommandKind.HOME]
    rig.ticks(2)
    assert rig.state is State.HOMING
    assert rig.words.count(MotionWord.WITHDRAW) == (50 if on_its_way_out else 0)


def test_a_motion_without_a_way_out_stops_where_it_is() -> None:
    rig = TipRun(down, INSIDE.replace(":Inside", ":Told")).to(-0.0018)
    rig.says = [CommandKind.STOP]
    assert rig.rests() < 60
    assert not rig.is_out()
    assert rig.run.cycle.tip == ""
