"""HOMING finds what the rig file says, or says why not; and what is known of a position is lost where it has to be."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from drivers.protocols.base import DriveStatus
from drivers.wire.faults import FaultKind
from hil.cycle.axis_homing import Step
from hil.cycle.fault_table import Fault
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.rig.schema import RigError
from hil.studies.fault_campaign.injections import axis_frames
from hil.telemetry.gateway import explain
from hil.virtual.lockstep import LockstepRun
from tests.support.homing import FARTHEST, PLACE, START, ZERO, home_once, homing_rig
from tests.support.paths import RIGS

NEAR = 20e-6  # m
COUNT = 1e-7  # m
WHOLE_WAY = [Step.SEARCH, Step.BACK_OFF, Step.LATCH, Step.MOVE_TO]


@pytest.mark.parametrize(
    ("by", "steps", "within"),
    [
        ("switch", WHOLE_WAY, NEAR),
        ("limit", WHOLE_WAY, NEAR),
        ("index", [Step.SEARCH, Step.MOVE_TO], COUNT),
        ("drive", [Step.SEARCH, Step.MOVE_TO], COUNT),
        ("absolute", [Step.SEARCH, Step.MOVE_TO], COUNT),
    ],
)
def test_what_is_stated_is_found(by: str, steps: list[Step], within: float, tmp_path: Path) -> None:
    _, homed = home_once(homing_rig(by, tmp_path), tmp_path)
    assert (homed.state, homed.fault, homed.known) == (State.READY, Fault.NONE, True), homed.why
    assert homed.steps == steps
    assert abs(homed.off) <= within
    assert homed.way < FARTHEST


@pytest.mark.long
def test_a_hard_stop_is_found_by_force_and_left_again(tmp_path: Path) -> None:
    run, homed = home_once(homing_rig("stop", tmp_path), tmp_path)
    assert (homed.state, homed.steps, homed.known) == (State.READY, WHOLE_WAY, True), homed.why
    assert abs(homed.off) < 5 * NEAR, "pressed in by the force"
    assert run.true_position[0] > PLACE + 1e-3


def test_here_is_where_the_axis_stands(tmp_path: Path) -> None:
    run, homed = home_once(homing_rig("here", tmp_path, home=", at=0.25"), tmp_path)
    assert homed.known
    assert run.cycle.inputs[0].position == pytest.approx(0.25, abs=2 * COUNT)
    assert homed.off == pytest.approx(0.25 - START, abs=2 * COUNT)


@pytest.mark.parametrize(("x", "y"), [(1, 0), (0, 3), (2, 2)])
def test_axes_home_in_their_order_and_those_of_one_number_together(x: int, y: int, tmp_path: Path) -> None:
    way = f"by='switch', farthest={FARTHEST}, speed=0.1, latch_speed=0.01, at={PLACE}"
    switches = ", ".join(f'{{axis="{axis}", home={PLACE}, zero={ZERO}}}' for axis in "xy")
    more = [
        f"plant.switches=[{switches}]",
        f"plant.initial_position=[{START}, {START}]",
        f"axes.x.home={{{way}, order={x}}}",
        f"axes.y.home={{{way}, order={y}}}",
    ]
    places: list[list[float]] = []
    _, homed = home_once(homing_rig("switch", tmp_path, more=more), tmp_path, places=places)
    moves = np.abs(np.diff(np.array(places), axis=0)) > COUNT
    assert (homed.state, homed.known) == (State.READY, True), homed.why
    first, last = moves.argmax(axis=0), len(moves) - 1 - moves[::-1].argmax(axis=0)
    if x == y:
        assert abs(first[0] - first[1]) <= 2
    else:
        early, late = (1, 0) if y < x else (0, 1)
        assert first[late] > last[early], "it is held until the other is done"


def test_where_the_axis_is_wanted_it_goes_at_last(tmp_path: Path) -> None:
    run, homed = home_once(homing_rig("switch", tmp_path, home=", move_to=0.005"), tmp_path)
    assert homed.known
    assert run.true_position[0] == pytest.approx(0.005, abs=2e-3)


@pytest.mark.requirement(id="SR-4.5")
@pytest.mark.parametrize("by", ["switch", "limit"])
@pytest.mark.parametrize(
    ("contact", "why"),
    [("dead", "not found"), ("stuck", "stays closed"), ("inverted", "stays closed")],
)
def test_a_switch_that_does_not_work_is_a_fault_within_the_way_allowed(
    by: str, contact: str, why: str, tmp_path: Path
) -> None:
    _, homed = home_once(homing_rig(by, tmp_path, contact=contact), tmp_path)
    assert (homed.state, homed.fault, homed.known) == (State.FAULT, Fault.HOMING_FAILED, False)
    assert why in homed.why
    assert homed.way <= FARTHEST


def test_a_contact_that_bounces_is_found_all_the_same(tmp_path: Path) -> None:
    _, homed = home_once(homing_rig("switch", tmp_path, contact="bouncing"), tmp_path)
    assert homed.known
    assert abs(homed.off) < NEAR


@pytest.mark.parametrize("start", [PLACE - 1e-6, PLACE - 0.03])
def test_a_table_that_stands_on_the_switch_backs_off_first(start: float, tmp_path: Path) -> None:
    _, homed = home_once(homing_rig("switch", tmp_path, start=start), tmp_path)
    assert (homed.steps, homed.known) == (WHOLE_WAY, True)
    assert abs(homed.off) < NEAR


def test_a_drive_that_is_not_homed_is_not_believed(tmp_path: Path) -> None:
    rig = homing_rig("drive", tmp_path, more=['plant.switches=[{axis="x", zero=0.1}]'])
    _, homed = home_once(rig, tmp_path)
    assert (homed.fault, homed.why) == (Fault.HOMING_FAILED, "its drive does not say that it is homed")


def test_a_place_beyond_the_way_allowed_is_not_gone_to(tmp_path: Path) -> None:
    _, homed = home_once(homing_rig("switch", tmp_path, home=", move_to=0.5"), tmp_path)
    assert (homed.fault, homed.known) == (Fault.HOMING_FAILED, False)
    assert "home.move_to is further" in homed.why


@pytest.mark.long
def test_an_axis_that_is_blocked_on_its_way_is_a_fault(tmp_path: Path) -> None:
    walls = ["plant.stage=./walled.py:Walled", "plant.parameters={low=-0.005}"]
    _, homed = home_once(homing_rig("switch", tmp_path, home=", force=3.0", more=walls), tmp_path)
    assert (homed.fault, homed.why) == (Fault.HOMING_FAILED, "it is blocked on its way")


# HOMING_REQUIRED ------------------------------------------------------------------------------------------------------


def asking(kind: CommandKind, at: int) -> object:
    def operator(run: LockstepRun, index: int) -> Sequence[CommandKind]:
        return (kind,) if index == at else ()

    return operator


@pytest.mark.parametrize("kind", [CommandKind.ACTIVATE, CommandKind.ACTIVATE_HOLD, CommandKind.LOAD_TASK])
def test_a_rig_that_is_yet_to_be_homed_refuses_and_says_what_to_do(kind: CommandKind, tmp_path: Path) -> None:
    rig = homing_rig("switch", tmp_path)
    run = LockstepRun(rig, tmp_path, operator=asking(kind, 60))  # type: ignore[arg-type]
    for _ in range(60):
        run.tick()
    if kind is CommandKind.LOAD_TASK:
        run.load_task(rig.task)
    record = run.tick().record
    assert run.cycle.state is State.READY
    assert [int(told["accepted"]) for told in record["commands"][: int(record["n_commands"])]] == [0] * int(
        record["n_commands"]
    )
    now = int(record["now_ns"])
    assert explain(kind, now, record, rig) == (
        "refused: HOMING_REQUIRED: x not homed since power-up; first: hil home paper"
    )


def test_a_simulation_homes_the_rig_before_its_task(tmp_path: Path) -> None:
    rig = homing_rig("here", tmp_path, more=["task.approach_s=0.2", "task.settle_s=0.1", "task.radius=0.01"])
    run = LockstepRun(rig, tmp_path)
    for _ in range(400):
        run.tick()
    assert (run.cycle.state, run.cycle.fault) == (State.ACTIVE, Fault.NONE)


# memory ---------------------------------------------------------------------------------------------------------------


@pytest.fixture
def at_home(tmp_path: Path) -> LockstepRun:
    """A rig that is homed and READY."""
    run, homed = home_once(homing_rig("here", tmp_path), tmp_path)
    assert homed.known
    return run


def known(run: LockstepRun, ticks: int) -> bool:
    for _ in range(ticks):
        run.tick()
    assert run.cycle.homing is not None
    return run.cycle.homing.known[0]


def test_a_drive_that_answers_keeps_the_axis_homed(at_home: LockstepRun) -> None:
    assert known(at_home, 500)


def test_an_encoder_at_fault_loses_it(at_home: LockstepRun) -> None:
    at_home.stage.drives[0].extra_status = int(DriveStatus.ENCODER_FAULT)
    assert not known(at_home, 3)


def test_a_drive_that_is_silent_loses_it(at_home: LockstepRun) -> None:
    axis_frames(FaultKind.DROP)(at_home, 0, 0)  # type: ignore[arg-type]
    assert not known(at_home, 20)


def test_a_count_that_jumps_loses_it(at_home: LockstepRun) -> None:
    counter = at_home.stage.drives[0].counter
    assert counter is not None
    counter.zero += 0.1
    assert not known(at_home, 5)


@pytest.mark.parametrize("counts_anew", [False, True])
def test_a_reset_keeps_it_and_a_drive_that_counts_anew_behind_it_loses_it(
    at_home: LockstepRun, counts_anew: bool
) -> None:
    asked = [CommandKind.ESTOP, CommandKind.RESET]
    at_home._operator = lambda run, index: [asked.pop(0)] if asked and index % 50 == 0 else ()
    counter = at_home.stage.drives[0].counter
    assert counter is not None
    while asked:
        at_home.tick()
    if counts_anew:
        counter.zero += 0.1
    assert known(at_home, 50) is not counts_anew


def test_another_process_knows_nothing(at_home: LockstepRun) -> None:
    at_home.restart()
    assert not known(at_home, 50)


def test_a_drive_that_takes_its_word_back_loses_it(tmp_path: Path) -> None:
    run, homed = home_once(homing_rig("drive", tmp_path), tmp_path)
    assert homed.known
    run.stage.drives[0].status &= ~int(DriveStatus.HOMED)
    assert not known(run, 3)


def test_after_homing_positions_are_true_and_a_task_begins(tmp_path: Path) -> None:
    run, homed = home_once(homing_rig("switch", tmp_path, zero=ZERO), tmp_path)
    run._operator = lambda run, index: [CommandKind.ACTIVATE_HOLD] if run.activated_at < 0 else ()
    for _ in range(60):
        run.tick()
    assert (run.cycle.state, run.cycle.fault) == (State.ACTIVE, Fault.NONE)
    assert run.cycle.inputs[0].position - run.true_position[0] == pytest.approx(homed.off, abs=2e-6)


# the rig file ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("home", "problem"),
    [
        ('by="switch"', 'home.farthest is required with home.by = "switch"'),
        ('by="switch",farthest=5.0', "home.farthest = 5: at most 2.88, 1.2 times the travel"),
        ('by="switch",farthest=0.1,speed=7.0', "home.speed = 7 exceeds limits.speed = 6"),
        (
            'by="switch",farthest=0.1,speed=0.1,latch_speed=0.2',
            "home.latch_speed = 0.2 exceeds the speed of the search",
        ),
        ('by="stop",farthest=0.1', 'home.force is required with home.by = "stop": above 1.146, at most 5'),
        ('by="stop",farthest=0.1,force=1.0', "home.force = 1: above 1.146 (coulomb and gravity), at most 5"),
        ('by="here",move_to=2.0,farthest=0.1', "home.move_to = 2: inside limits.position, -1.2 to 1.2"),
        ('by="limit",farthest=0.1', 'home.by = "limit" needs limits.switches = true'),
        ('by="switch",farthest=0.1,method=17,acceleration=1.0', 'home.method = 17 goes with home.by = "drive"'),
        ('by="drive",farthest=0.1,method=17', "home.method and home.acceleration go together"),
        ('by="drive",farthest=0.1,acceleration=1.0', "home.method and home.acceleration go together"),
        ('by="drive",method=17,acceleration=1.0', 'home.farthest is required with home.by = "drive"'),
        (
            'by="drive",farthest=0.1,method=17,acceleration=1.0',
            "home.force is required with home.method: above 1.146, at most 5",
        ),
        (
            'by="drive",farthest=0.1,method=17,acceleration=1.0,force=3.0',
            "axes.x.home.method: no drive can be told to home over bus.protocol = 'stage_fd'",
        ),
        ('by="absolute",at=0.1', "home.at: an absolute encoder is corrected by axes.NAME.offset"),
    ],
)
def test_what_cannot_be_is_refused_with_key_value_and_range(home: str, problem: str) -> None:
    with pytest.raises(RigError) as refused:
        load_rig(RIGS / "paper.toml", [f"axes.x.home={{{home}}}"])
    assert problem in str(refused.value)
