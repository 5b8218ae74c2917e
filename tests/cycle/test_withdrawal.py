"""WITHDRAW: before the rig stops, the tip goes to its safe height; where it must not move, words say that it stays."""

import math
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from drivers.protocols.base import DriveStatus
from drivers.wire.faults import FaultKind, WireFault
from hil.cycle.fault_table import Fault
from hil.cycle.goal import Goal, GoalKind, MotionWord, Refusal
from hil.cycle.limits import motion_limits
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.cycle.withdrawal import LATE_S, WITHIN_S
from hil.events.event import Event
from hil.events.sources import events_of
from hil.events.table import Kind
from hil.rig.carried_code import carried_code
from hil.rig.file import load_rig
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.lockstep import LockstepRun
from hil.virtual.replay import replay_run
from sim_plant.nodes.sensor import silent, tapped
from tests.support import told_motion
from tests.support.paths import RIGS

RIG = RIGS / "microscope-ideal.toml"
INSIDE = f"motion.name={Path(told_motion.__file__)}:Inside"
OUTPUT = "outputs.valve={can_id=0x3E0, bit=0, longest_s=9}"
SENSOR = '{{can_id={:#x}, unit="N", scale=1e-8, noise=5e-6, range=[-0.01, 0.01]}}'
SAFE, DEEP, SPEED, PERIOD = -0.001, -0.002, 0.01, 1e-3
X, Z = 0, 2
Answer = Callable[[hil.Observation], Any]


def down(seen: hil.Observation) -> hil.References:
    """Along z to DEEP at SPEED, and to stay there; the valve open."""
    before = seen.reference[Z][0]
    speed = max(seen.reference[Z][1] - 2e-5, -SPEED) if before > DEEP + 0.002 * SPEED else 0.0
    place = max(before + 0.5 * (seen.reference[Z][1] + speed) * PERIOD, DEEP)
    return hil.References([0.0, 0.0, place, 0.0], [0.0, 0.0, speed, 0.0], outputs=1, phase=3)


class Rig:
    """A run whose tip goes down into something. rows: its records; told: its events; says: for the next tick."""

    def __init__(self, answer: Answer = down, *changes: str) -> None:
        self.rig = load_rig(RIG, ("task.kind=hold", INSIDE, OUTPUT, *changes))
        self.rows: list[np.void] = []
        self.told: list[Event] = []
        self.says: list[CommandKind] = []
        self._events = events_of(self.rig)

        def observe(tick: object, frames: object, result: Any) -> None:
            self.rows.append(result.record.copy())
            self.told += self._events.observe(self.run.cycle, result.record)

        self.run = LockstepRun(self.rig, RIGS, observer=observe, operator=lambda run, tick: self._say())
        decided = self.run.cycle.supervisor.goals.decided
        assert decided is not None
        decided.motion.told = answer

    def _say(self) -> list[CommandKind]:
        if self.run.cycle.state is State.READY and self.run.activated_at < 0:
            return [CommandKind.ACTIVATE]
        said, self.says = self.says, []
        return said

    def ticks(self, count: int) -> "Rig":
        for _ in range(count):
            self.run.tick()
        return self

    def to(self, place: float) -> "Rig":
        """Until the tip is there."""
        while self.z > place:
            self.run.tick()
            assert self.run.index < 2000
        return self

    def shows(self, axis: int, bit: DriveStatus) -> None:
        """The drive shows a bit of its status, from now on."""
        self.run.stage.drives[axis].extra_status |= int(bit)

    @property
    def z(self) -> float:
        return float(self.run.true_position[Z])

    @property
    def state(self) -> State:
        return self.run.cycle.state

    @property
    def words(self) -> list[int]:
        return [int(row["motion"]) for row in self.rows]

    def becomes_ready(self) -> None:
        while self.state is not State.READY:
            self.run.tick()
            assert self.run.index < 5000

    def rests(self, *, patience: int = 400) -> int:
        """Ticks until no torque is permitted."""
        begun = self.run.index
        while self.state in (State.ACTIVE, State.STOPPING):
            self.run.tick()
            assert self.run.index - begun < patience
        return self.run.index - begun

    def lines(self, kind: Kind) -> list[str]:
        return [event.line for event in [*self.told, *self._events.close()] if event.kind is kind]

    def is_out(self) -> bool:
        return self.z > SAFE - 8e-5

    def keeps_its_limits(self) -> None:
        li = motion_limits(self.rig)[Z]
        speeds = np.array([row["setpoint_velocity"][Z] for row in self.rows if row["state"] != State.READY])
        assert np.abs(speeds).max() <= li.speed * (1 + 1e-9)
        assert np.abs(np.diff(speeds)).max() <= li.acceleration * PERIOD * 1.01


@pytest.mark.requirement(id="SR-8.4")
def test_an_operators_stop_leads_the_tip_out_at_an_even_pace_and_leaves_no_fault() -> None:
    rig = Rig().to(-0.0015)
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
    rig = Rig().to(-0.0004)
    rig.says = [CommandKind.STOP]
    before = rig.z
    assert rig.rests() < 60
    assert MotionWord.WITHDRAW not in rig.words
    assert abs(rig.z - before) < SPEED * 0.02


def test_a_process_that_is_told_to_end_leads_the_tip_out_first() -> None:
    rig = Rig().to(-0.0015)
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
def test_a_motion_that_fails_inside_is_withdrawn_from_and_one_that_fails_outside_is_held(
    answer: Answer, place: float
) -> None:
    rig = Rig().to(place + 1e-6)
    decided = rig.run.cycle.supervisor.goals.decided
    assert decided is not None
    decided.motion.told = answer
    rig.ticks(1)
    assert rig.state is State.STOPPING
    rig.rests()
    assert (rig.state, rig.run.cycle.fault, rig.is_out()) == (State.READY, Fault.NONE, True)
    assert any("the motion failed; the tip goes to its safe height first" in line for line in rig.lines(Kind.STATE))
    rig.keeps_its_limits()

    outside = Rig().to(-0.0003)
    decided = outside.run.cycle.supervisor.goals.decided
    assert decided is not None
    decided.motion.told = answer
    outside.ticks(300)
    assert (outside.state, outside.words[-1]) == (State.ACTIVE, MotionWord.HOLD)


@pytest.mark.long
def test_a_motion_that_never_answers_is_withdrawn_from() -> None:
    rig = Rig().to(-0.0015)
    decided = rig.run.cycle.supervisor.goals.decided
    assert decided is not None
    decided.motion.told = late
    rig.rests()
    assert rig.is_out()


@pytest.mark.requirement(id="SR-8.4")
@pytest.mark.parametrize("channel", range(4))
def test_a_dead_sensor_leads_the_tip_out_whatever_its_channel(channel: int) -> None:
    """The third channel's number is that of axis z."""
    sensors = [f"sensors.s{n}={SENSOR.format(0x3F1 + n)}" for n in range(4)]
    rig = Rig(down, *sensors).to(-0.0015)
    nodes = rig.run.stage.sensors
    tapped([nodes[channel]], silent)
    took = rig.rests()
    assert (rig.state, rig.run.cycle.fault, rig.is_out()) == (State.FAULT, Fault.SENSOR_SILENT, True)
    assert took <= 320
    assert rig.lines(Kind.TIP) == []


def test_a_fault_of_the_axis_itself_is_for_the_damped_stop_and_words_lead_the_tip_out() -> None:
    rig = Rig(down, "axes.z.limits.switches=true").to(-0.0015)
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


def test_another_axis_that_is_at_fault_gets_the_damped_stop_while_the_tip_goes_out() -> None:
    rig = Rig(down, "axes.x.limits.switches=true").to(-0.0015)
    rig.shows(X, DriveStatus.LIMIT_HIGH)
    rig.rests()
    assert (rig.run.cycle.fault, rig.is_out()) == (Fault.LIMIT_SWITCH, True)
    led = [row for row in rig.rows if row["motion"] == MotionWord.WITHDRAW]
    assert len(led) > 100
    assert not any(row["force_requested"][X] for row in led[2:]), "no law holds x: its velocity is zero"
    rig = Rig(down, "axes.z.limits.switches=true").to(-0.0015)
    rig.shows(Z, DriveStatus.LIMIT_LOW)
    rig.rests()
    assert (rig.run.cycle.fault, rig.is_out()) == (Fault.LIMIT_SWITCH, False)
    assert len(rig.lines(Kind.TIP)) == 1


@pytest.mark.parametrize("axis", [X, Z])
def test_without_samples_nothing_is_led_anywhere(axis: int) -> None:
    rig = Rig().to(-0.0015)
    rig.run.wire.inject(WireFault(FaultKind.DROP, from_ns=rig.run.wire.now_ns, node=rig.rig.axis_names[axis]))
    rig.rests()
    assert rig.run.cycle.fault is Fault.ENCODER_LOST
    assert MotionWord.WITHDRAW not in rig.words
    assert not rig.is_out()


STAYS: dict[str, Callable[[Rig], None]] = {
    "emergency stop": lambda rig: rig.says.append(CommandKind.ESTOP),
    "stop line": lambda rig: setattr(rig.run, "estop", True),
    "drive fault": lambda rig: rig.run.stage.drives[X].fail(),
}


@pytest.mark.parametrize("happens", STAYS.values(), ids=STAYS)
@pytest.mark.parametrize("on_its_way_out", [False, True])
def test_the_tip_stays_where_nothing_may_move_and_the_words_lead_it_back(
    happens: Callable[[Rig], None], on_its_way_out: bool
) -> None:
    """As the words say: reset, activate-hold, and a move to the safe height."""
    rig = Rig().to(-0.0018)
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


def test_a_tip_that_a_goal_holds_inside_is_led_out_by_the_stop() -> None:
    rig = Rig().to(-0.0018)
    rig.run.goals.append(Goal(1, GoalKind.HALT))
    rig.ticks(200)
    assert rig.words[-1] == MotionWord.HOLD
    rig.says = [CommandKind.STOP]
    rig.rests()
    assert rig.is_out()


def test_no_goal_and_no_second_stop_changes_the_way_out() -> None:
    rig = Rig().to(-0.0018)
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

    rig = Rig(hostile).to(-0.0013).ticks(draw.randrange(40))
    rig.says = [CommandKind.STOP]
    rig.rests()
    assert MotionWord.WITHDRAW in rig.words
    assert rig.is_out()
    rig.keeps_its_limits()


def test_a_motion_without_a_way_out_stops_where_it_is() -> None:
    rig = Rig(down, INSIDE.replace(":Inside", ":Told")).to(-0.0018)
    rig.says = [CommandKind.STOP]
    assert rig.rests() < 60
    assert not rig.is_out()
    assert rig.run.cycle.tip == ""


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ('{axis="w"}', "retreat.axis = 'w'; the axes are x, y, z, theta"),
        ("{direction=0}", "retreat.direction = 0; allowed: -1 or 1"),
        ("{position=0.1}", "retreat.position = 0.1; allowed: from -0.00"),
        ("{position=nan}", "retreat.position = nan; allowed"),
    ],
)
def test_a_way_out_that_cannot_be_is_refused_by_its_name(parameters: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        LockstepRun(load_rig(RIG, ("task.kind=hold", INSIDE, f"motion.parameters={parameters}")), RIGS)


def test_a_way_out_is_read_once_and_nothing_that_the_motion_does_later_changes_it() -> None:
    rig = Rig().to(-0.0015)
    decided = rig.run.cycle.supervisor.goals.decided
    assert decided is not None
    decided.motion.retreat = hil.Retreat("z", -0.005, -1)
    rig.says = [CommandKind.STOP]
    rig.rests()
    assert rig.is_out()


@pytest.mark.parametrize("declared", [("z", 0.0, -1), "z", 0])
def test_a_way_out_that_is_none_is_refused(declared: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hil.Motion, "retreat", declared)
    with pytest.raises(ValueError, match=r"retreat = .*, expected hil.Retreat"):
        LockstepRun(load_rig(RIG, ("task.kind=hold", INSIDE.replace(":Inside", ":ToAndFro"))), RIGS)


def test_the_stop_of_a_slow_axis_is_given_the_time_that_its_way_out_takes() -> None:
    quick = Rig().run.cycle.supervisor.longest_stop_s
    slow = Rig(down, "axes.z.motion.speed=0.002").run.cycle.supervisor.longest_stop_s
    assert quick < 0.5
    assert 2.0 < slow < 3.0


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
