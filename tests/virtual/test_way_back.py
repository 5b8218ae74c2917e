"""An axis that rests beyond its travel is brought back by goals: inwards, slowly, with less force."""

import numpy as np
import pytest

import hil
from hil.cycle.fault_table import Fault
from hil.cycle.goal import Goal, GoalKind, MotionWord
from hil.cycle.limits import motion_limits, return_forces
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.cycle.travel import Travel
from hil.rig.file import load_rig
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import RIGS

LOW, HIGH = -0.026, 0.026  # of the microscope's x


def beyond(place: float, *changes: str, rig: str = "microscope-ideal") -> hil.VirtualMover:
    mover = hil.motion(hil.load_rig(rig, [f"plant.initial_position=[{place}, 0.0, 0.0, 0.0]", *changes]))
    assert isinstance(mover, hil.VirtualMover)
    return mover


@pytest.mark.requirement(id="SR-4.6")
@pytest.mark.long
@pytest.mark.parametrize("rig", ["microscope-ideal", "microscope"])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_it_is_held_where_it_rests_and_goals_lead_it_back(side: float, rig: str) -> None:
    with beyond(side * 0.028, rig=rig) as m:
        m.sleep(0.5)
        assert m.status().position[0] == pytest.approx(side * 0.028, abs=1e-4)
        with pytest.raises(hil.GoalRefusedError, match="the travel less its margin"):
            m.move_by(x=side * 1e-3)
        look = m.move_to(x=side * 0.02).wait(5.0)
        assert (look.state, look.fault) == (State.ACTIVE, Fault.NONE)
        m.move_to(x=0.0).wait(5.0)
    run = m.run()
    out = np.abs(run.columns["position"][:, 0]) > HIGH
    held = run.columns["motion"] != MotionWord.NONE
    limits, (force, *_) = motion_limits(m._link.rig)[0], return_forces(m._link.rig)
    assert np.nanmax(np.abs(run.columns["setpoint_velocity"][out & held, 0])) <= 0.2 * limits.speed * (1.0 + 1e-9)
    assert np.nanmax(np.abs(run.columns["setpoint_velocity"][held, 0])) > 0.2 * limits.speed, "inside as always"
    pushed = run.columns["force"][out & held, 0]
    assert np.abs(pushed).max() <= force < m._link.rig.axes["x"].limits.force
    assert (pushed * side).max() <= 0.0, "never outwards"


def test_the_task_does_not_begin_there() -> None:
    run = hil.simulate(hil.load_rig("microscope-ideal", ["plant.initial_position=[0.028, 0.0, 0.0, 0.0]"]), seconds=0.3)
    assert set(run.columns["state"].tolist()) <= {State.BOOT, State.CONNECTED, State.READY}


def test_pushed_out_while_it_holds_it_is_reset_held_there_and_led_back() -> None:
    asked: list[CommandKind] = []
    rig = load_rig(RIGS / "paper.toml", ["axes.x.limits.position=[-1.0, 0.02]"])
    run = LockstepRun(rig, RIGS, operator=lambda run, index: [asked.pop()] if asked else [])

    def until(state: State) -> None:
        first = run.index
        while run.cycle.state is not state:
            run.tick()
            assert run.index < first + 5000, (run.cycle.state, run.cycle.fault)

    until(State.READY)
    asked.append(CommandKind.ACTIVATE_HOLD)
    until(State.ACTIVE)
    run.stage.push(0, 1.5 * rig.axes["x"].limits.force)
    until(State.FAULT)
    run.stage.push(0, 0.0)
    for _ in range(3000):
        run.tick()
    while run.true_position[0] < 0.02:
        run.stage.push(0, 2.0 * rig.axes["x"].model.coulomb)
        run.tick()
    run.stage.push(0, 0.0)
    for _ in range(3000):
        run.tick()
    asked.append(CommandKind.RESET)
    until(State.READY)
    asked.append(CommandKind.ACTIVATE)
    run.tick()
    assert run.cycle.commands.refused == 1
    asked.append(CommandKind.ACTIVATE_HOLD)
    for _ in range(500):
        run.tick()
    assert (run.cycle.state, run.cycle.fault) == (State.ACTIVE, Fault.NONE)
    assert run.true_position[0] > 0.02
    run.goals.append(Goal(1, GoalKind.MOVE, mask=1, position=(0.0, 0.0, 0.0, 0.0)))
    for _ in range(3000):
        run.tick()
    assert (run.cycle.state, run.cycle.fault) == (State.ACTIVE, Fault.NONE)
    assert abs(run.true_position[0]) < 1e-3


def test_what_it_has_come_back_it_does_not_get_again() -> None:
    m = beyond(0.028)
    with m:
        m.move_to(x=0.02)
        while m.status().position[0] > 0.0275:
            m.sleep(1e-3)
        m.halt()
        m.sleep(0.5)
        rig = m._link.rig
        edge = m._simulated.run.cycle.monitor.travel[0].high
        room = rig.axes["x"].limits.following_error
        columns = m.run().columns
        innermost = columns["position"][columns["motion"] != MotionWord.NONE, 0].min()
        assert edge == pytest.approx(innermost + room, abs=1e-9)
        m._simulated.run.stage.push(0, return_forces(rig)[0] + 1.0)  # N, outwards
        while m.status().state is State.ACTIVE:
            m.sleep(1e-3)
            assert m.now_ns() < 10e9
        assert m.status().position[0] < edge + 1e-4
    assert m._simulated.run.cycle.fault in (Fault.TRAVEL, Fault.TRAVEL_PLANNED, Fault.FOLLOWING_ERROR)


@pytest.mark.requirement(id="SR-4.6")
def test_the_travel_narrows_behind_an_axis_and_is_never_wider_than_where_it_began() -> None:
    travel = Travel(-1.0, 1.0, 0.1)
    travel.begin_at(0.5)
    assert (travel.low, travel.high, travel.wide) == (-1.0, 1.0, False)
    travel.begin_at(1.5)
    assert (travel.low, travel.high, travel.wide) == (-1.0, 1.6, True)
    for position, high in ((1.55, 1.6), (1.3, 1.4), (1.35, 1.4), (0.95, 1.05), (0.5, 1.0), (1.5, 1.0)):
        travel.follow(position)
        assert travel.high == pytest.approx(high)
    assert not travel.wide
    travel.begin_at(-1.2)
    assert travel.wide
    assert travel.low == pytest.approx(-1.3)
    travel.restart()
    assert (travel.low, travel.high, travel.wide) == (-1.0, 1.0, False)
