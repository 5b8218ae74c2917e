"""The commissioning push: a task runs on axes whose sign and scale have been seen, and on no others."""

import tomllib
from typing import Any

import pytest

from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.step import ControlCycle
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import RIGS

PUSH = {"x": {"force": 1.6, "distance": 4e-3}, "y": {"force": 0.4, "distance": 4e-3}}


def document(**axis: Any) -> dict[str, Any]:
    rig = tomllib.loads((RIGS / "paper.toml").read_text())
    for name, push in PUSH.items():
        rig["axes"][name] |= {"push": push, **axis}
    return rig


def run_of(believed: dict[str, Any], ticks: int = 200) -> LockstepRun:
    """The paper's stage, controlled by somebody who believes this of it."""
    run = LockstepRun(RigConfig.model_validate(document()), RIGS)
    run.cycle = ControlCycle(RigConfig.model_validate(believed), RIGS)
    for _ in range(ticks):
        run.tick()
    return run


def test_the_task_begins_behind_the_pushes_at_rest_where_they_ended() -> None:
    run = run_of(document())
    assert run.cycle.state is State.ACTIVE
    assert run.cycle.supervisor.commissioning.done
    assert run.cycle.setpoints.trajectory is not None
    run.cycle.supervisor.commissioning.cancel()
    assert run.cycle.supervisor.commissioning.done  # once in the life of a control process


def test_the_axes_are_pushed_one_after_the_other_and_no_further_than_they_must_be() -> None:
    run = run_of(document(), 40)
    assert run.cycle.supervisor.commissioning.running
    assert run.true_position[1] == 0.0  # friction holds it
    while run.cycle.supervisor.commissioning.running:
        run.tick()
    assert all(4e-3 < position < 8e-3 for position in run.true_position)
    assert max(abs(run.true_velocity)) < 0.05


@pytest.mark.requirement(id="SR-4.5")
@pytest.mark.parametrize(
    ("torque", "stated", "says"),
    [
        (-1.0, {}, "the wrong way"),  # motor or encoder turn the other way round
        (5.0, {}, "too far"),
        (0.8, {}, "too little"),  # hardly beyond friction
        (0.0, {}, "too little"),
        (1.0, {"encoder_resolution": 1e-8}, "too little"),
        (1.0, {"encoder_resolution": 1e-6}, "too far"),
    ],
)
def test_an_axis_that_is_not_as_stated_gets_no_task(torque: float, stated: dict[str, Any], says: str) -> None:
    run = run_of(document(**stated), 0)
    run.stage.drives[0].gain = torque
    for _ in range(200):
        run.tick()
    assert (run.cycle.state, run.cycle.fault) == (State.FAULT, Fault.AXIS_NOT_AS_STATED)
    assert says in run.cycle.problems[0]
    assert run.cycle.problems[0].startswith("axis x: pushed by +1.6")
    assert run.cycle.setpoints.trajectory is None
    assert not run.cycle.supervisor.commissioning.running
    assert max(abs(run.true_position)) < 0.06  # with no brake it runs on until friction has stopped it


def test_a_mirrored_axis_agrees_with_itself() -> None:
    """Force and position are both turned round: no push can tell, somebody has to look."""
    assert run_of(document(direction=-1)).cycle.state is State.ACTIVE


def test_a_stop_ends_the_push_and_the_next_activation_begins_it_anew() -> None:
    run = run_of(document(), 40)
    run.stop = True
    for _ in range(60):
        run.tick()
    assert run.cycle.state is State.SHUTDOWN
    assert not run.cycle.supervisor.commissioning.running
    assert not run.cycle.supervisor.commissioning.done


@pytest.mark.parametrize(
    ("push", "says"),
    [
        ({"force": 1.0, "distance": 1e-3}, "does not move an axis with coulomb"),
        ({"force": 1.146, "distance": 1e-3}, "does not move an axis with coulomb"),
        ({"force": 6.0, "distance": 1e-3}, "beyond axes.x.limits.force"),
        ({"force": 4.0, "distance": 1e-4}, "at least 8"),
        ({"force": 1.6, "distance": 1e-2}, "a quarter of axes.x.limits.following_error"),
    ],
)
def test_a_push_that_cannot_tell_is_refused(push: dict[str, float], says: str) -> None:
    rig = document()
    rig["axes"]["x"]["push"] = push
    with pytest.raises(ValueError, match=says):
        ControlCycle(RigConfig.model_validate(rig), RIGS)


def test_an_axis_is_pushed_towards_the_middle_of_its_travel_and_judged_in_that_direction() -> None:
    """0.4 N beyond friction and 0.5 mm a tick: the way of the force is right, the other one is not."""
    for start, sign in ((-0.25, 1.0), (0.0, 1.0), (0.25, -1.0)):
        for moves, problem in ((sign, ""), (-sign, "the wrong way")):
            commissioning = ControlCycle(RigConfig.model_validate(document()), RIGS).supervisor.commissioning
            commissioning.start([start, 0.0])
            pushed, held = commissioning.force([0.0, 0.0])
            assert (pushed, held) == (1.6 * sign, 0.0)
            position = start
            for _ in range(3):
                position += 0.5e-3 * moves
                commissioning.advance([position, 0.0], [0.0, 0.0])
            assert problem in commissioning.problem
            assert bool(commissioning.problem) is bool(problem)
            if problem:
                assert f"pushed by {1.6 * sign:+g} for" in commissioning.problem
                assert commissioning.moved * sign < 0.0 <= commissioning.expected * sign
