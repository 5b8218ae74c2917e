"""Motions that decide as they go, in lockstep: what they ask for is followed within every limit, and no further."""

import itertools
import math
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.cycle.goal import Goal, GoalKind, MotionWord, Refusal
from hil.cycle.limits import motion_limits
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.carried_code import carried_code
from hil.rig.file import load_rig
from hil.rig.schema import RigError
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.lockstep import LockstepRun
from hil.virtual.replay import replay_run
from tests.support import told_motion
from tests.support.paths import RIGS
from tests.support.records import kept

RIG = RIGS / "microscope-ideal.toml"
TOLD = Path(told_motion.__file__)
OUTPUT = "outputs.valve={can_id=0x3E0, bit=0, longest_s=0.02}"
FORCE = 'sensors.force={can_id=0x3F1, unit="N", scale=1e-8, noise=5e-6, range=[-0.01, 0.01]}'
Step = Callable[[hil.Observation], Any]


class Decided:
    """A rig whose motion is a function of the test's. rows: the records of its run."""

    def __init__(self, step: Step, *changes: str) -> None:
        name = f"motion.name={TOLD}:Told"
        self.rig = load_rig(RIG, ("task.kind=hold", name, *changes))
        self.rows: list[np.void] = []
        self.accelerations: list[list[float]] = []

        def observe(tick: object, frames: object, result: Any) -> None:
            self.rows.append(kept(result.record))
            self.frames = result.frames
            self.accelerations.append([x.end.acceleration for x in self.run.cycle.inputs])

        self.run = LockstepRun(self.rig, RIGS, observer=observe)
        self.decided = self.run.cycle.supervisor.goals.decided
        assert self.decided is not None
        self.decided.motion.told = step

    def ticks(self, count: int) -> "Decided":
        for _ in range(count):
            self.run.tick()
        return self

    def begin(self) -> "Decided":
        while self.run.cycle.supervisor.goals.word is MotionWord.NONE:
            self.run.tick()
            assert self.run.index < 2000
        return self

    @property
    def word(self) -> MotionWord:
        return MotionWord(int(self.rows[-1]["motion"]))

    def ask(self, kind: int, **more: Any) -> int:
        self.run.goals.append(Goal(1, kind, **more))
        self.run.tick()
        return int(self.rows[-1]["goals"][0]["refusal"])

    def keeps_its_limits(self) -> None:
        setpoints = np.array([row["setpoint_position"] for row in self.rows])
        speeds = np.array([row["setpoint_velocity"] for row in self.rows])
        bends = np.array(self.accelerations)
        for axis, li in enumerate(motion_limits(self.rig)):
            assert li.low - 1e-12 <= setpoints[:, axis].min()
            assert setpoints[:, axis].max() <= li.high + 1e-12
            assert np.abs(speeds[:, axis]).max() <= li.speed * (1 + 1e-9)
            assert np.abs(bends[:, axis]).max() <= li.acceleration * (1 + 1e-9)
            assert np.abs(np.diff(bends[:, axis])).max() <= li.jerk * 1.002e-3  # clocks step by 1 us


def still(seen: hil.Observation) -> hil.References:
    return hil.References([0.0] * 4, [0.0] * 4)


def test_a_plan_expressed_as_a_motion_has_the_plans_setpoints_and_sends_the_same_frames() -> None:
    plain = LockstepRun(load_rig(RIG), RIGS)
    plan: list[Any] = []

    def planned(seen: hil.Observation) -> hil.References:
        if not plan:
            plan.append(plain.cycle.supervisor._plan([at for at, _, _ in seen.reference]))
        at = [plan[0].at(axis, end) for axis, end in enumerate(seen.ends_ns)]
        return hil.References(*([values[k] for values in at] for k in range(3)))

    told = Decided(planned)
    for _ in range(1200):  # far into the way to the first cell
        expected = plain.tick()
        told.ticks(1)
        assert np.abs(told.rows[-1]["setpoint_position"] - expected.record["setpoint_position"]).max() < 1e-17
        assert [frame[:2] for frame in expected.frames] == [frame[:2] for frame in told.frames]


def _hostile(seed: int) -> Iterator[Any]:
    draw = random.Random(seed)
    odd = [math.nan, math.inf, -math.inf, 1e300, -1e300, 0.0, 1.0, -1.0, 1e-9]
    place = [0.0] * 4
    while True:
        kind = draw.randrange(6)
        if kind == 0:
            yield hil.References([draw.choice(odd[3:]) for _ in range(4)], [draw.uniform(-9, 9) for _ in range(4)])
        elif kind == 1:
            place = [draw.uniform(-0.05, 0.05) for _ in range(4)]
            yield hil.References(place, [0.0] * 4, [draw.uniform(-1e6, 1e6) for _ in range(4)])
        elif kind == 2:
            place = [p + draw.uniform(-1e-6, 1e-6) for p in place]
            yield hil.References(place, [draw.gauss(0.0, 1e-3) for _ in range(4)])
        else:
            yield hil.References(place, [0.0] * 4)


@pytest.mark.requirement(id="SR-4.2")
@pytest.mark.parametrize("seed", range(3))
def test_hostile_references_break_no_limit_and_are_counted(seed: int) -> None:
    """Jumps, absurd speeds and accelerations, targets beyond the travel: the axes stay within what they have."""
    asked = _hostile(seed)
    told = Decided(lambda seen: next(asked)).begin().ticks(1500)
    told.keeps_its_limits()
    assert told.run.cycle.state is State.ACTIVE
    assert told.word is MotionWord.MOTION
    assert told.rows[-1]["limited"] > 100


@pytest.mark.requirement(id="SR-1.4")
@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (lambda seen: hil.References([math.nan] * 4, [0.0] * 4), "position"),
        (lambda seen: hil.References([0.0] * 3, [0.0] * 4), "3 values of position for 4 axes"),
        (lambda seen: hil.References([0.0] * 4, [0.0] * 4, outputs=256), "outputs = 256"),
        (lambda seen: hil.References([0.0] * 4, [0.0] * 4, phase=-1), "phase = -1"),
        (lambda seen: None, "expected hil.References"),
        (lambda seen: 1 / 0, "ZeroDivisionError"),
    ],
)
def test_an_answer_that_is_none_ends_the_motion_at_rest_and_says_why(answer: Step, words: str) -> None:
    """On its way at 20 mm/s it fails: the axis comes to rest by its plan, and is held."""
    way = 0.0

    def step(seen: hil.Observation) -> Any:
        nonlocal way
        if seen.tick > 300:
            return answer(seen)
        speed = min(seen.tick * 1e-4, 0.02)
        way += (seen.reference[0][1] + speed) * 5e-4
        return hil.References([way, 0.0, 0.0, 0.0], [speed, 0.0, 0.0, 0.0])

    told = Decided(step).begin().ticks(290)
    assert told.rows[-1]["setpoint_velocity"][0] > 0.01
    assert told.word is MotionWord.MOTION
    told.ticks(15)
    assert told.word is MotionWord.MOVE
    assert words in told.run.cycle.failure
    told.ticks(300)
    assert told.word is MotionWord.HOLD
    assert told.run.cycle.state is State.ACTIVE
    told.keeps_its_limits()


def test_a_goal_ends_the_motion_where_the_rig_lets_it() -> None:
    told = Decided(still).begin().ticks(20)
    assert told.ask(GoalKind.MOVE, position=(1e-4, 0.0, 0.0, 0.0)) == Refusal.NONE
    told.ticks(600)
    assert told.word is MotionWord.HOLD
    assert abs(told.rows[-1]["position"][0] - 1e-4) < 1e-6

    told = Decided(still, "motion.interrupt=false").begin().ticks(20)
    assert told.ask(GoalKind.HALT) == Refusal.TASK
    assert told.word is MotionWord.MOTION


def test_activate_hold_begins_without_the_motion() -> None:
    told = Decided(still)
    told.run._operator = lambda run, tick: (CommandKind.ACTIVATE_HOLD,) if run.cycle.state is State.READY else ()
    told.begin()
    assert told.run.cycle.supervisor.goals.word is MotionWord.HOLD


def test_a_motion_hears_a_request_in_the_tick_that_takes_it_and_goes_on() -> None:
    heard: list[hil.Request] = []

    def step(seen: hil.Observation) -> hil.References:
        heard.append(seen.request)
        return hil.References([0.0] * 4, [0.0] * 4)

    told = Decided(step, "motion.interrupt=false").begin().ticks(5)
    before = len(heard)
    assert told.ask(GoalKind.REQUEST, flags=hil.Request.SKIP) == Refusal.NONE
    told.ticks(3)
    assert heard[before:] == [hil.Request.SKIP, *[hil.Request.NONE] * 3]
    assert told.word is MotionWord.MOTION


@pytest.mark.parametrize("flags", [0, 5, 0xFFFF])
def test_a_request_that_is_none_is_refused_and_the_motion_hears_nothing(flags: int) -> None:
    heard: list[hil.Request] = []

    def step(seen: hil.Observation) -> hil.References:
        heard.append(seen.request)
        return hil.References([0.0] * 4, [0.0] * 4)

    told = Decided(step).begin().ticks(5)
    assert told.ask(GoalKind.REQUEST, flags=flags) == Refusal.UNKNOWN
    told.ticks(3)
    assert set(heard) == {hil.Request.NONE}


def test_where_no_motion_runs_a_request_is_refused_and_the_next_motion_does_not_hear_it() -> None:
    told = Decided(still).begin().ticks(5)
    assert told.ask(GoalKind.HALT) == Refusal.NONE
    assert told.ask(GoalKind.REQUEST, flags=hil.Request.ABORT) == Refusal.NO_MOTION


def test_a_motion_sees_readings_with_their_age_and_what_the_axes_do() -> None:
    seen: list[hil.Observation] = []

    def step(looked: hil.Observation) -> hil.References:
        seen.append(looked)
        return hil.References([0.0] * 4, [0.0] * 4)

    Decided(step, FORCE).begin().ticks(20)
    last = seen[-1]
    assert last.tick == 20
    assert len(last.readings) == 1
    assert last.readings[0].valid
    assert last.ages == [0]
    assert abs(last.readings[0].value) < 5e-5
    assert max(map(abs, last.position)) < 1e-4
    assert [at for at, _, _ in last.reference] == [0.0] * 4
    assert [b - a for a, b in zip(seen[-2].ends_ns, last.ends_ns, strict=True)] == [1_000_000] * 4


# outputs --------------------------------------------------------------------------------------------------------------


def outputs(told: Decided) -> list[int]:
    return [int(row["outputs"]) for row in told.rows]


@pytest.mark.requirement(id="SR-8.2")
def test_an_output_is_set_as_asked_and_no_longer_than_it_may_be() -> None:
    told = (
        Decided(
            lambda seen: hil.References([0.0] * 4, [0.0] * 4, outputs=int(10 <= seen.tick < 60 or seen.tick >= 70) | 2),
            OUTPUT,
        )
        .begin()
        .ticks(100)
    )
    found = outputs(told)
    begun = next(k for k, row in enumerate(told.rows) if row["motion"] == MotionWord.MOTION)
    expected = [int(10 <= k < 30 or 70 <= k < 90) for k in range(len(found) - begun)]
    assert found[:begun] == [0] * begun
    assert found[begun:] == expected


@pytest.mark.requirement(id="SR-8.2")
def test_no_output_outlives_the_motion_the_state_or_a_fault() -> None:
    told = Decided(lambda seen: hil.References([0.0] * 4, [0.0] * 4, outputs=1), OUTPUT.replace("0.02", "9")).begin()
    told.ticks(5)
    assert outputs(told)[-1] == 1
    told.ask(GoalKind.HALT)
    assert outputs(told)[-1] == 0
    told = Decided(lambda seen: hil.References([0.0] * 4, [0.0] * 4, outputs=1), OUTPUT.replace("0.02", "9")).begin()
    told.ticks(5)
    told.run.estop = True
    told.ticks(1)
    assert outputs(told)[-1] == 0
    told.ticks(50)
    assert not any(outputs(told)[-50:])


def test_a_motion_sees_that_a_tick_with_a_fault_has_cleared_its_output() -> None:
    """A missed tick stops nothing, but closes the valve until it is asked for anew."""
    seen_set: list[int] = []

    def step(seen: hil.Observation) -> hil.References:
        seen_set.append(seen.outputs)
        return hil.References([0.0] * 4, [0.0] * 4, outputs=1)

    told = Decided(step, OUTPUT.replace("0.02", "9")).begin().ticks(20)
    assert seen_set == [0, *[1] * (len(seen_set) - 1)]
    told.run.skip(1)
    told.ticks(1)
    assert int(told.rows[-1]["fault"]) == 0
    assert outputs(told)[-2:] == [1, 0]
    told.ticks(20)
    assert not any(outputs(told)[-20:])
    assert seen_set[-20:] == [0] * 20


def test_the_frame_of_the_outputs_follows_the_command_in_every_tick_and_says_itself_twice() -> None:
    told = Decided(lambda seen: hil.References([0.0] * 4, [0.0] * 4, outputs=1), OUTPUT).begin().ticks(10)
    frames = [
        frame for row in told.rows[-5:] for frame in row["sent"][: int(row["n_sent"])] if frame["can_id"] == 0x3E0
    ]
    assert len(frames) == 5
    for frame in frames:
        assert frame["length"] == 3
        assert frame["data"][0] == 1
        assert frame["data"][1] == 0xFE
    counts = [int(frame["data"][2]) for frame in frames]
    assert [(b - a) % 256 for a, b in itertools.pairwise(counts)] == [1] * 4


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("task.kind=circle", "it takes the place of a task"),
        ("motion.name=nobody", "the motions are cells"),
        ("motion.parameters={speed=1}", "parameters.speed: "),
        (
            "outputs={a={can_id=0x3E0, bit=0, longest_s=1}, b={can_id=0x3E0, bit=0, longest_s=1}}",
            "the bit of outputs.a",
        ),
        (
            "outputs={a={can_id=0x3E0, bit=0, longest_s=1}, b={can_id=0x3E1, bit=1, longest_s=1}}",
            "all are in one frame",
        ),
        ("outputs.a={can_id=0x3E0, bit=9, longest_s=1}", "outputs.a.bit"),
    ],
)
def test_what_cannot_be_is_refused_by_its_key(change: str, words: str) -> None:
    name = f"motion.name={TOLD}:Told"

    def begun() -> LockstepRun:
        return LockstepRun(load_rig(RIG, ("task.kind=hold", name, 'task.axes=["x", "y"]', change)), RIGS)

    with pytest.raises((RigError, ValueError), match=words):
        begun()


def test_an_identifier_that_a_drive_has_is_refused() -> None:
    rig = load_rig(RIG, ("outputs.a={can_id=0x100, bit=0, longest_s=1}",))
    taken = LockstepRun(load_rig(RIG), RIGS).cycle.protocol.messages(rig.period_ns)[0]
    rig = load_rig(RIG, (f"outputs.a={{can_id={taken.can_id}, bit=0, longest_s=1}}",))
    with pytest.raises(
        ValueError, match=rf"outputs.a.can_id = {taken.can_id:#x}: '{taken.name}' of|'{taken.name}' has"
    ):
        LockstepRun(rig, RIGS)


def test_a_recording_of_a_motion_replays_byte_for_byte(tmp_path: Path) -> None:
    name = f"motion.name={TOLD}:ToAndFro"
    rig = load_rig(RIG, ("task.kind=hold", name, OUTPUT, FORCE))
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, RIG)
    run = LockstepRun(rig, RIGS, observer=recorder.observe)
    for _ in range(600):
        run.tick()
    recorder.close()
    permitted = [code.digest for code in carried_code(rig)]
    report = replay_run(tmp_path / "run.mcap", permitted=permitted)
    assert report.ticks == 600
    assert not report.different
    assert report.gap_at is None
