"""Another law for a rig at rest, in lockstep: taken in READY and in HOLD, without a step of the force; it replays."""

from pathlib import Path

import numpy as np
import pytest

from hil.cycle import axes as cycle_axes
from hil.cycle.goal import Goal, GoalKind, MotionWord
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.task_loading import law_document, rig_with_law
from hil.rig.file import load_rig
from hil.rig.schema import LawConfig, RigError
from hil.telemetry.recorder import LockstepRecorder
from hil.telemetry.recording import RecordingError
from hil.virtual.lockstep import LockstepRun
from hil.virtual.replay import replay_run
from tests.live.test_task_loading import PAPER, Operator, ready, until
from tests.support.paths import RIGS

IDEAL = RIGS / "microscope-ideal.toml"
CIRCLE = ["task.kind=circle", "task.axes=['x', 'y']", "task.radius=5e-3", "task.approach_s=0.2", "task.settle_s=0.0"]


def with_law(run: LockstepRun, name: str, **gains: float) -> bool:
    """Whether it was taken."""
    run.set_law(LawConfig(name=name, gains=gains, tuned=run.rig.law.tuned))
    run.tick()
    ((_, accepted),) = run.cycle.commands.handled
    return accepted


def forces(run: LockstepRun, ticks: int) -> np.ndarray:
    return np.array([run.tick().record["force"][: len(run.rig.axes)].copy() for _ in range(ticks)])


def held_off_its_target(rig_file: Path, law: str, **options: object) -> LockstepRun:
    """In HOLD behind a move, with some error that friction leaves."""
    run, operator = ready(load_rig(rig_file, [f"law.name={law}"]), **options)
    operator.next = [CommandKind.ACTIVATE_HOLD]
    while run.cycle.supervisor.goals.word is not MotionWord.HOLD:
        run.tick()
    run.goals.append(Goal(1, GoalKind.MOVE, mask=1, position=(2e-5, 0.0, 0.0, 0.0)))
    forces(run, 400)
    assert run.cycle.supervisor.goals.word is MotionWord.HOLD
    return run


def test_a_law_that_is_set_in_ready_is_that_of_the_rig_file() -> None:
    positions = []
    for own in ("structured-kalman", "pid"):
        run, operator = ready(load_rig(PAPER, [f"law.name={own}", *CIRCLE]))
        if own == "pid":
            assert with_law(run, "structured-kalman")
        else:
            run.tick()
        operator.next = [CommandKind.ACTIVATE]
        until(run, State.ACTIVE)
        for _ in range(600):
            run.tick()
        assert run.cycle.fault == 0
        positions.append(run.true_position.tolist())
    assert positions[0] == positions[1]
    assert abs(positions[0][0]) > 1e-3


@pytest.mark.parametrize(("rig_file", "old", "new", "gains", "most"), [
    (IDEAL, "pd-feedforward", "structured-kalman", {}, 2.5e-3),
    (IDEAL, "structured-kalman", "pd-feedforward", {}, 3e-4),
    (RIGS / "microscope.toml", "presliding-kalman", "presliding-kalman", {"bandwidth": 0.25}, 2.5e-3),
])  # fmt: skip
def test_under_torque_the_force_goes_on_without_a_step(
    rig_file: Path, old: str, new: str, gains: dict[str, float], most: float
) -> None:
    """most: N, between two ticks; where the axes are not ideal, their encoders' noise alone makes 1e-3 N."""
    run = held_off_its_target(rig_file, old)
    before = forces(run, 1)
    assert with_law(run, new, **gains)
    taken = [run.cycle.gate.force]
    without = held_off_its_target(rig_file, old)
    assert taken == forces(without, 2)[1:].tolist(), "in the tick that takes it"
    steps = np.abs(np.diff(np.vstack([before, taken, forces(run, 80)]), axis=0))
    assert steps.max() < most
    assert run.cycle.gate.force != forces(without, 80)[-1].tolist(), "it is another law"
    assert (run.cycle.state, run.cycle.fault) == (State.ACTIVE, 0)


@pytest.mark.replaces_methods
def test_without_a_handover_there_would_be_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    run = held_off_its_target(IDEAL, "pd-feedforward")
    monkeypatch.setattr(cycle_axes, "Handover", lambda _old, new, _period_s: new)
    before = forces(run, 1)
    assert with_law(run, "structured-kalman")
    assert np.abs(np.array(run.cycle.gate.force) - before).max() > 0.5


def test_it_is_refused_while_an_axis_moves_and_in_every_other_state() -> None:
    run = held_off_its_target(IDEAL, "structured-kalman")
    law = run.cycle.law
    run.goals.append(Goal(2, GoalKind.MOVE, mask=1, position=(1e-3, 0.0, 0.0, 0.0)))
    run.tick()
    assert not with_law(run, "pd-feedforward")
    for _ in range(2):
        run.estop = True
        run.tick()
    assert run.cycle.state is State.ESTOP
    assert not with_law(run, "pd-feedforward")
    assert run.cycle.law is law
    fresh = LockstepRun(load_rig(PAPER), PAPER.parent, operator=Operator())
    assert not with_law(fresh, "pid")


def test_a_law_that_comes_without_one_is_refused() -> None:
    run, operator = ready(load_rig(PAPER))
    operator.next = [CommandKind.SET_LAW]
    run.tick()
    assert [accepted for _, accepted in run.cycle.commands.handled] == [False]


@pytest.mark.parametrize(("overrides", "document", "text"), [
    ([], "{", "law: no JSON"),
    ([], '{"name": "pidd"}', "one of hil's own laws is set: pd-feedforward, "),
    ([], '{"nam": "pid"}', "law.nam = 'pid'"),
    ([], '{"name": "pid", "iterative_learning": true}', "a law that learns is not set while the rig runs"),
    (["law.iterative_learning=true", *CIRCLE], '{"name": "pid"}', "a law that learns is not set while the rig runs"),
    ([], '{"name": "numpy:ndarray", "source": "x"}', "one of hil's own laws is set: pd-feedforward, "),
])  # fmt: skip
def test_a_law_that_a_running_rig_cannot_take_is_refused_by_key(overrides: list[str], document: str, text: str) -> None:
    with pytest.raises(RigError) as caught:
        rig_with_law(load_rig(PAPER, overrides), document)
    assert text in str(caught.value)


def test_a_gain_out_of_its_range_is_named_before_anything_is_asked() -> None:
    run, _ = ready(load_rig(PAPER))
    with pytest.raises(ValueError, match=r"law\.gains\.kp = -1"):
        run.set_law(LawConfig(name="pid", gains={"kp": -1.0}))


def test_what_travels_is_the_law_and_the_gains_that_count() -> None:
    law = LawConfig(name="pid", gains={"kp": 2.0}, tuned={"pid": {"kp": 1.0, "kd": 3.0}, "pd-feedforward": {"kp": 9.0}})
    assert law_document(law) == '{"gains":{"kd":3.0,"kp":2.0},"name":"pid"}'


def recorded(path: Path) -> None:
    recorder = LockstepRecorder(path, load_rig(IDEAL, ["law.name=structured-kalman"]), IDEAL)
    run = held_off_its_target(IDEAL, "structured-kalman", observer=recorder.observe)
    assert with_law(run, "pd-feedforward")
    run.goals.append(Goal(2, GoalKind.MOVE, mask=1, position=(1e-3, 0.0, 0.0, 0.0)))
    forces(run, 300)
    assert run.cycle.fault == 0
    recorder.close()


def test_the_recording_alone_gives_every_frame_again(tmp_path: Path) -> None:
    recorded(tmp_path / "run.mcap")
    report = replay_run(tmp_path / "run.mcap")
    assert report.ticks > 700
    assert report.different == 0


def test_another_law_that_is_compared_with_keeps_its_own(tmp_path: Path) -> None:
    recorded(tmp_path / "run.mcap")
    report = replay_run(tmp_path / "run.mcap", ("law.name=structured-kalman", "law.gains.bandwidth=200.0"))
    assert report.different == 0
    assert report.other_force is not None
    assert report.other_force["x"]["max"] > 0.01


def test_a_recording_that_lost_the_law_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LockstepRecorder, "_note_loaded", lambda *_: None)
    recorded(tmp_path / "run.mcap")
    with pytest.raises(RecordingError, match=r"the law that tick \d+ loads is not in it"):
        replay_run(tmp_path / "run.mcap")
