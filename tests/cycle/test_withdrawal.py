"""WITHDRAW: before the rig stops, the tip goes to its safe height."""

import math
import random
from pathlib import Path

import pytest

import hil
from drivers.protocols.base import DriveStatus
from hil.cycle.fault_table import Fault
from hil.cycle.goal import Goal, GoalKind, MotionWord, Refusal
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.cycle.withdrawal import LATE_S, WITHIN_S
from hil.events.table import Kind
from hil.rig.carried_code import carried_code
from hil.rig.file import load_rig
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.lockstep import LockstepRun
from hil.virtual.replay import replay_run
from sim_plant.nodes.sensor import silent, tapped
from tests.support.paths import RIGS
from tests.support.tip import DEEP, INSIDE, PERIOD, RIG, SENSOR, SPEED, Answer, TipRun, X, Z, down


@pytest.mark.requirement(id="SR-8.4")
def test_an_operators_stop_leads_the_tip_out_at_an_even_pace_and_leaves_no_fault() -> None:
    rig = TipRun().to(-0.0015)
    assert int(rig.rows[-1]["outputs"]) == 1
    rig.says = [CommandKind.STOP]
    took = rig.rests()
    assert rig.is_out()
    assert took <= (WITHIN_S + LATE_S + rig.rig.safety.stop_s) / PERIOD
    assert (rig.state, rig.run.cycle.fault) == (State.READY, Fault.NONE)
    stopping = [row for row in rig.rows if row["state"] == State.STOPPING]
    assert {int(row["outputs"]) for row in stopping} == {0}, "closed from the first tick of the stop on"
    assert max(row["setpoint_velocity"][Z] for row in stopping) < 3 * 0.0005 / WITHIN_S, "not quicker than it need be"
    rig.keeps_its_limits()
    assert any("command STOP; the tip goes to its safe height first" in line for line in rig.lines(Kind.STATE))
    assert rig.lines(Kind.TIP) == []


def test_a_stop_above_the_safe_height_moves_nothing() -> None:
    rig = TipRun().to(-0.0004)
    rig.says = [CommandKind.STOP]
    before = rig.z
    assert rig.rests() < 60
    assert MotionWord.WITHDRAW not in rig.words
    assert abs(rig.z - before) < SPEED * 0.02


def test_a_process_that_is_told_to_end_leads_the_tip_out_first() -> None:
    rig = TipRun().to(-0.0015)
    rig.run.stop = True
    rig.rests()
    assert rig.state is State.SHUTDOWN
    assert rig.is_out()


def late(seen: hil.Observation) -> hil.References:
    while True:
        pass


FAILS: dict[str, Answer] = {
    "NaN": lambda seen: hil.References([math.nan] * 4, [0.0] * 4),
    "nothing": lambda seen: None,
    "an exception": lambda seen: 1 / 0,
    "too few": lambda seen: hil.References([0.0], [0.0]),
}


@pytest.mark.parametrize("answer", FAILS.values(), ids=FAILS)
@pytest.mark.parametrize("place", [-0.0013, DEEP])
def test_a_motion_that_fails_inside_is_withdrawn_from(answer: Answer, place: float) -> None:
    rig = TipRun().to(place + 1e-6)
    rig.motion.told = answer
    rig.ticks(1)
    assert rig.state is State.STOPPING
    rig.rests()
    assert (rig.state, rig.run.cycle.fault, rig.is_out()) == (State.READY, Fault.NONE, True)
    assert any("the motion failed; the tip goes to its safe height first" in line for line in rig.lines(Kind.STATE))
    rig.keeps_its_limits()


@pytest.mark.parametrize("answer", FAILS.values(), ids=FAILS)
def test_a_motion_that_fails_outside_is_held(answer: Answer) -> None:
    outside = TipRun().to(-0.0003)
    outside.motion.told = answer
    outside.ticks(300)
    assert (outside.state, outside.words[-1]) == (State.ACTIVE, MotionWord.HOLD)


@pytest.mark.long
def test_a_motion_that_never_answers_is_withdrawn_from() -> None:
    rig = TipRun().to(-0.0015)
    rig.motion.told = late
    rig.rests()
    assert rig.is_out()


@pytest.mark.requirement(id="SR-8.4")
@pytest.mark.parametrize("channel", range(4))
def test_a_dead_sensor_leads_the_tip_out_whatever_its_channel(channel: int) -> None:
    """The third channel's number is that of axis z."""
    sensors = [f"sensors.s{n}={SENSOR.format(0x3F1 + n)}" for n in range(4)]
    rig = TipRun(down, *sensors).to(-0.0015)
    nodes = rig.run.stage.sensors
    tapped([nodes[channel]], silent)
    took = rig.rests()
    assert (rig.state, rig.run.cycle.fault, rig.is_out()) == (State.FAULT, Fault.SENSOR_SILENT, True)
    assert took <= 320
    assert rig.lines(Kind.TIP) == []


def test_another_axis_that_is_at_fault_gets_the_damped_stop_while_the_tip_goes_out() -> None:
    rig = TipRun(down, "axes.x.limits.switches=true").to(-0.0015)
    rig.shows(X, DriveStatus.LIMIT_HIGH)
    rig.rests()
    assert (rig.run.cycle.fault, rig.is_out()) == (Fault.LIMIT_SWITCH, True)
    led = [row for row in rig.rows if row["motion"] == MotionWord.WITHDRAW]
    assert len(led) > 100
    assert not any(row["force_requested"][X] for row in led[2:]), "no law holds x: its velocity is zero"
    rig = TipRun(down, "axes.z.limits.switches=true").to(-0.0015)
    rig.shows(Z, DriveStatus.LIMIT_LOW)
    rig.rests()
    assert (rig.run.cycle.fault, rig.is_out()) == (Fault.LIMIT_SWITCH, False)
    assert len(rig.lines(Kind.TIP)) == 1


def test_a_tip_that_a_goal_holds_inside_is_led_out_by_the_stop() -> None:
    rig = TipRun().to(-0.0018)
    rig.run.goals.append(Goal(1, GoalKind.HALT))
    rig.ticks(200)
    assert rig.words[-1] == MotionWord.HOLD
    rig.says = [CommandKind.STOP]
    rig.rests()
    assert rig.is_out()


def test_no_goal_and_no_second_stop_changes_the_way_out() -> None:
    rig = TipRun().to(-0.0018)
    rig.says = [CommandKind.STOP]
    rig.ticks(20)
    refused = int(rig.rows[-1]["commands_refused"])
    rig.says = [CommandKind.STOP]
    rig.run.goals.append(Goal(1, GoalKind.MOVE, position=(0.01, 0.01, DEEP, 0.0)))
    rig.ticks(1)
    assert int(rig.rows[-1]["goals"][0]["refusal"]) == Refusal.NOT_ACTIVE
    assert int(rig.rows[-1]["commands_refused"]) == refused + 1
    rig.rests()
    assert rig.is_out()
    assert abs(rig.run.true_position[X]) < 1e-6


@pytest.mark.requirement(id="SR-8.4")
@pytest.mark.parametrize("seed", range(4))
def test_from_whatever_a_hostile_motion_has_begun_the_way_out_keeps_every_limit(seed: int) -> None:
    draw = random.Random(seed)

    def hostile(seen: hil.Observation) -> hil.References:
        place = [draw.uniform(-0.02, 0.02) for _ in range(4)]
        return hil.References([*place[:2], draw.uniform(-0.005, -0.002), 0.0], [draw.uniform(-9, 9) for _ in range(4)])

    rig = TipRun(hostile).to(-0.0013).ticks(draw.randrange(40))
    rig.says = [CommandKind.STOP]
    rig.rests()
    assert MotionWord.WITHDRAW in rig.words
    assert rig.is_out()
    rig.keeps_its_limits()


def test_a_recording_of_a_way_out_replays_byte_for_byte(tmp_path: Path) -> None:
    rig = load_rig(RIG, ("task.kind=hold", INSIDE.replace(":Inside", ":DownAndFail")))
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, RIG)
    run = LockstepRun(rig, RIGS, observer=recorder.observe)
    words = []
    for _ in range(900):
        words.append(int(run.tick().record["motion"]))
    recorder.close()
    assert words.count(MotionWord.WITHDRAW) > 100
    report = replay_run(tmp_path / "run.mcap", permitted=[code.digest for code in carried_code(rig)])
    assert (report.ticks, report.gap_at) == (900, None)
    assert not report.different
