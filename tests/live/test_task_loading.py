"""Another task for a rig at rest, in lockstep: what is taken, what is refused, and that it replays."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from hil.cycle.goal import Goal, GoalKind, MotionWord
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.live.task_loading import rig_with_task
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError, TaskConfig
from hil.telemetry.recorder import LockstepRecorder
from hil.telemetry.recording import RecordingError
from hil.virtual.lockstep import LockstepRun
from hil.virtual.replay import exact_motion, replay_run
from tests.support.paths import RIGS

PAPER = RIGS / "paper.toml"
HOLD = ["task.kind=hold"]
CIRCLE = {"kind": "circle", "axes": ["x", "y"], "radius": 5e-3, "approach_s": 0.2, "settle_s": 0.0}
RASTER = {"kind": "raster", "axes": ["x", "y"], "corner": [0.0, 0.0], "size": [5e-3, 1e-3], "approach_s": 0.2}


class Operator:
    """Sends what it is told to, in the tick it is told to."""

    def __init__(self) -> None:
        self.next: list[CommandKind] = []

    def __call__(self, run: LockstepRun, index: int) -> Sequence[CommandKind]:
        asked, self.next = self.next, []
        return asked


def ready(rig: RigConfig, **options: object) -> tuple[LockstepRun, Operator]:
    operator = Operator()
    run = LockstepRun(rig, PAPER.parent, operator=operator, **options)  # type: ignore[arg-type]
    until(run, State.READY)
    return run, operator


def until(run: LockstepRun, state: State, ticks: int = 1000) -> None:
    for _ in range(ticks):
        if run.cycle.state is state:
            return
        run.tick()
    raise AssertionError(f"{run.cycle.state}, not {state}")


def load(run: LockstepRun, task: dict[str, object]) -> bool:
    run.load_task(TaskConfig.model_validate(task))
    run.tick()
    ((_, accepted),) = run.cycle.commands.handled
    return accepted


@pytest.mark.parametrize("task", [CIRCLE, RASTER])
def test_a_task_is_taken_at_rest_and_followed_as_if_it_had_been_the_rigs(task: dict[str, object]) -> None:
    hashes = []
    for own in (HOLD, [f"task.{key}={value!r}" for key, value in task.items()]):
        run, operator = ready(load_rig(PAPER, own))
        assert load(run, task)
        operator.next = [CommandKind.ACTIVATE]
        positions = []
        for _ in range(600):
            run.tick()
            positions.append(run.true_position.tolist())
        assert (run.cycle.state, run.cycle.fault) == (State.ACTIVE, 0)
        hashes.append(positions)
    assert hashes[0] == hashes[1]
    assert max(abs(x) for x, _ in hashes[0]) > 1e-3


def test_it_is_refused_in_every_other_state() -> None:
    run, operator = ready(load_rig(PAPER, HOLD))
    operator.next = [CommandKind.ACTIVATE]
    until(run, State.ACTIVE)
    assert not load(run, CIRCLE)
    operator.next = [CommandKind.ESTOP]
    until(run, State.ESTOP)
    assert not load(run, CIRCLE)
    assert run.cycle.commands.refused == 2
    fresh = LockstepRun(load_rig(PAPER, HOLD), PAPER.parent, operator=Operator())
    assert not load(fresh, CIRCLE)


def test_it_is_taken_while_the_axes_hold_and_begun_by_a_goal() -> None:
    run, operator = ready(load_rig(PAPER, HOLD))
    operator.next = [CommandKind.ACTIVATE_HOLD]
    for _ in range(100):
        run.tick()
    assert run.cycle.supervisor.goals.word is MotionWord.HOLD
    assert load(run, RASTER)
    run.goals.append(Goal(1, GoalKind.PATH))
    run.tick()
    assert run.cycle.supervisor.goals.word is MotionWord.PATH
    assert not load(run, CIRCLE), "while it moves"
    before = run.cycle.supervisor.start_ranges
    for _ in range(20):
        run.tick()
    assert run.cycle.supervisor.start_ranges is before
    assert (run.cycle.state, run.cycle.fault) == (State.ACTIVE, 0)


def test_where_it_cannot_begin_it_is_refused_and_the_old_one_stays() -> None:
    run, operator = ready(load_rig(PAPER, [*HOLD, "plant.initial_position=[1.0, 0.0]"]))
    before = run.cycle.supervisor.start_ranges
    far = {"kind": "point_to_point", "axes": ["x"], "target": [-1.0], "move_s": 0.2}
    assert not load(run, far)
    assert run.cycle.supervisor.start_ranges is before
    operator.next = [CommandKind.ACTIVATE]
    until(run, State.ACTIVE)
    for _ in range(200):
        run.tick()
    assert abs(run.true_position[0] - 1.0) < 1e-3


def test_a_law_that_learns_from_repeats_takes_no_other_task() -> None:
    rig = load_rig(PAPER, ["task.kind=circle", "task.axes=['x', 'y']", "law.iterative_learning=true"])
    run, _ = ready(rig)
    assert not load(run, CIRCLE)


def test_the_last_one_loaded_counts_also_after_a_stop() -> None:
    run, operator = ready(load_rig(PAPER, HOLD))
    assert load(run, CIRCLE)
    assert load(run, RASTER)
    for _ in range(2):
        operator.next = [CommandKind.ACTIVATE]
        until(run, State.ACTIVE)
        for _ in range(50):
            run.tick()
        trajectory = run.cycle.setpoints.trajectory
        assert trajectory is not None
        assert trajectory.phase_names == ("approach", "path")
        operator.next = [CommandKind.STOP]
        until(run, State.READY)


@pytest.mark.parametrize(("document", "text"), [
    ("{", "task: no JSON"),
    ('{"kind": "circel"}', "the nearest is circle"),
    ('{"kind": "circle", "axes": ["x"]}', "a circle needs two axes"),
    ('{"kind": "circle", "radios": 1}', "task.radios = 1"),
    ('{"kind": "waypoints", "axes": ["x"], "waypoints": [[0.0], [9.0]]}', "row 2, column x: 9 is outside"),
    ("[]", "task = []"),
])  # fmt: skip
def test_a_task_that_is_none_is_refused_by_key_row_and_column(document: str, text: str) -> None:
    with pytest.raises(RigError) as caught:
        rig_with_task(load_rig(PAPER), document)
    assert text in str(caught.value)


def recorded(path: Path) -> None:
    rig = load_rig(PAPER, HOLD)
    recorder = LockstepRecorder(path, rig, PAPER)
    run, operator = ready(rig, observer=recorder.observe)
    assert load(run, RASTER)
    operator.next = [CommandKind.ACTIVATE]
    for _ in range(500):
        run.tick()
    recorder.close()


def test_the_recording_holds_the_task(tmp_path: Path) -> None:
    recorded(tmp_path / "run.mcap")
    report = replay_run(tmp_path / "run.mcap")
    assert report.ticks > 500
    assert report.different == 0
    motion = exact_motion(tmp_path / "run.mcap")
    assert motion is not None
    assert abs(motion["position"]).max() > 1e-4


def test_a_recording_that_lost_the_task_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LockstepRecorder, "_note_loaded", lambda *_: None)
    recorded(tmp_path / "run.mcap")
    with pytest.raises(RecordingError, match=r"the task that tick \d+ loads is not in it"):
        replay_run(tmp_path / "run.mcap")
