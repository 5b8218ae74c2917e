"""Goals that are refused: with a reason, and without an effect on what the axes do."""

import pytest

from hil.control.plans.axis_plan import AxisPlan
from hil.cycle.goal import RELATIVE, Goal, GoalKind, MotionWord, Refusal
from tests.support.held import MS, TASK, Held

NAN = float("nan")
WRONG = [
    ({"kind": 99}, Refusal.UNKNOWN),
    ({"kind": GoalKind.MOVE, "mask": 0b10000}, Refusal.UNKNOWN),
    ({"kind": GoalKind.MOVE, "flags": 64}, Refusal.UNKNOWN),
    ({"kind": GoalKind.MOVE, "position": (NAN, 0.0, 0.0, 0.0)}, Refusal.NOT_FINITE),
    ({"kind": GoalKind.JOG, "velocity": (float("inf"), 0.0, 0.0, 0.0)}, Refusal.NOT_FINITE),
    ({"kind": GoalKind.JOG, "valid_ns": 600 * MS}, Refusal.NOT_FINITE),
    ({"kind": GoalKind.JOG, "valid_ns": -1}, Refusal.NOT_FINITE),
    ({"kind": GoalKind.KNOT, "due_ns": -1}, Refusal.NOT_FINITE),
    ({"kind": GoalKind.MOVE, "speed": 0.0}, Refusal.NOT_FINITE),
    ({"kind": GoalKind.MOVE, "speed": 1.1}, Refusal.NOT_FINITE),
    ({"kind": GoalKind.MOVE, "position": (1e9, 0.0, 0.0, 0.0)}, Refusal.FENCE),
    ({"kind": GoalKind.RATE, "speed": 0.5}, Refusal.NO_PATH),
]


@pytest.mark.requirement(id="SR-4.4")
@pytest.mark.parametrize(("wrong", "refusal"), WRONG)
def test_a_goal_that_cannot_be_is_refused_with_its_reason_and_changes_nothing(
    wrong: dict[str, object], refusal: Refusal
) -> None:
    held = Held()
    before = held.setpoint
    held.run.goals.append(Goal(1, **wrong))  # type: ignore[arg-type]
    held.ticks(2)
    assert int(held.records[-2]["goals"][0]["refusal"]) == refusal
    assert refusal.text
    assert held.setpoint == before
    assert held.desk.word is MotionWord.HOLD
    assert held.records[-1]["goals_refused"] == 1


REFUSED = {
    "a place beyond the travel": (Refusal.FENCE, {"position": (9.0, 0.0, 0.0, 0.0)}),
    "a way that leads beyond it": (Refusal.FENCE, {"position": (9.0, 0.0, 0.0, 0.0), "flags": RELATIVE}),
    "a place that is no number": (Refusal.NOT_FINITE, {"position": (float("nan"), 0.0, 0.0, 0.0)}),
}


@pytest.mark.parametrize(("refusal", "goal"), REFUSED.values(), ids=REFUSED)
@pytest.mark.parametrize("paused", [False, True])
def test_a_goal_that_is_refused_leaves_the_task_as_it_runs(
    refusal: Refusal, goal: dict[str, object], paused: bool
) -> None:
    asked, left = Held(*TASK, hold=False), Held(*TASK, hold=False)
    for held in (asked, left):
        held.ticks(1_000)
        if paused:
            held.ask(GoalKind.RATE, speed=0.3)
    asked.run.goals.append(Goal(7, GoalKind.MOVE, 1, **goal))  # type: ignore[arg-type]
    for held in (asked, left):
        held.ticks(200)
    assert int(asked.records[-200]["goals"][0]["refusal"]) == refusal
    assert asked.desk.word is left.desk.word is MotionWord.TASK
    assert [record["force"].tolist() for record in asked.records] == [
        record["force"].tolist() for record in left.records
    ]


@pytest.mark.replaces_methods
def test_a_goal_without_a_plan_within_the_limits_leaves_the_task_as_it_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    held = Held(*TASK, hold=False)
    held.ticks(1_000)
    before = held.setpoint
    monkeypatch.setattr(AxisPlan, "keeps", lambda plan, limits: False)
    assert held.ask(GoalKind.JOG, velocity=(-0.01, 0.0, 0.0, 0.0), mask=1) == Refusal.LIMITS
    held.ticks(50)
    assert held.desk.word is MotionWord.TASK
    assert held.setpoint[:2] != before[:2]
