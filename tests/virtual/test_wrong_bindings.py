"""Wrong bindings, drawn by seeds: each is refused by `hil check`, or kept from READY, or shown by the push.

A sign or a scale that no file states can only be seen by a torque. The push is this torque: it is small, and no task
runs before it.
"""

from pathlib import Path
from typing import NamedTuple

import pytest

from hil.cycle.state_machine import State
from hil.cycle.step import ControlCycle
from hil.rig.bus_load import refuse_unschedulable
from hil.rig.encoder_range import encoder_range_problems
from hil.rig.schema import RigConfig, RigError
from hil.virtual.lockstep import LockstepRun
from tests.support.wrong_bindings import RIGS_OF, Bound, WrongBinding, drawn, write

PATIENCE = {"enable_timeout_ticks": 60, "disable_timeout_ticks": 30}
TICKS = 330
SEEDS = range(48)
FAMILIES = {family: made for family, (made, _) in RIGS_OF.items() if "," not in family}
# what no frame of a drive at rest tells: how strong it is, which way it goes, how far its encoder counts
ONLY_BY_THE_PUSH = (
    "torque = ",  # T_MAX of the MIT kind
    "resolution with it",  # P_MAX of the MIT kind, where the axis follows it
    "bytes of the",
    "half of the position",
    "sign",
    " times ",
    "scale of",
    "torque of the axes",
    "drives exchanged",  # whose axes differ
)


class Outcome(NamedTuple):
    """refused: in these words, before a bus is opened. ready, task: it got there. torque: the most a drive applied."""

    refused: str = ""
    ready: bool = False
    task: bool = False
    torque: float = 0.0


def rig_of(bound: Bound) -> RigConfig:
    bound.rig["safety"] = bound.rig.get("safety", {}) | PATIENCE
    return RigConfig.model_validate(bound.rig)


def met(binding: WrongBinding, folder: Path) -> Outcome:
    """The wrong rig meets the right drives."""
    write(binding.right, folder / "right")
    write(binding.wrong, folder / "wrong")
    run = LockstepRun(rig_of(binding.right), folder / "right")
    try:
        rig = rig_of(binding.wrong)
        layout = refuse_unschedulable(rig, folder / "wrong")
        if problems := encoder_range_problems(rig, layout):
            return Outcome(problems[0])
        run.cycle = ControlCycle(rig, folder / "wrong", layout)
    except (ValueError, RigError) as error:
        return Outcome(str(error))
    ready, torque = False, 0.0
    while run.index < TICKS and run.cycle.state not in (State.FAULT, State.ESTOP):
        run.tick()
        ready |= run.cycle.state is State.READY
        torque = max(torque, *(abs(servo.force) for servo in run.stage.drives))
        if run.cycle.setpoints.trajectory is not None:
            return Outcome(ready=ready, task=True, torque=torque)
    return Outcome(ready=ready, torque=torque)


@pytest.mark.parametrize("family", FAMILIES)
def test_without_a_mistake_the_task_runs(family: str, tmp_path: Path) -> None:
    right = FAMILIES[family]()
    assert met(WrongBinding(family, "none", right, right), tmp_path).task


@pytest.mark.parametrize("seed", SEEDS)
def test_a_wrong_binding_runs_no_task(seed: int, tmp_path: Path) -> None:
    binding = drawn(seed)
    outcome = met(binding, tmp_path)
    assert not outcome.task, binding.what
    assert "\n" not in outcome.refused
    if outcome.torque > 0.0:
        assert outcome.ready
        assert any(kind in binding.what for kind in ONLY_BY_THE_PUSH), f"{binding.what}: torque before it was seen"


def test_the_seeds_have_each_family_and_many_mistakes() -> None:
    all_drawn = [drawn(seed) for seed in SEEDS]
    assert len({(binding.family, binding.what) for binding in all_drawn}) >= 40
    assert {binding.family for binding in all_drawn} == {*FAMILIES}
    again = [drawn(seed) for seed in SEEDS]
    assert [binding.what for binding in again] == [binding.what for binding in all_drawn]
