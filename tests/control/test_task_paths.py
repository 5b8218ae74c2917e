"""Tasks from files, by waypoints, rasters and spirals: what is followed, and what is refused with row and column."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.analysis.feasibility import horizon
from hil.control.trajectories import make_trajectory
from hil.control.trajectories.base import Trajectory
from hil.control.trajectories.paths import apart, raster_points, waypoints
from hil.control.trajectories.rows import along_rows as spline
from hil.control.trajectories.segments import Segments
from hil.rig.file import build_rig, load_rig, rig_hash
from hil.rig.schema import RigConfig, RigError, TaskConfig
from hil.rig.task_file import read_task_file
from hil.telemetry.recorder import LockstepRecorder
from hil.virtual.batch import BatchRun
from hil.virtual.lockstep import LockstepRun
from hil.virtual.replay import replay_run
from hil.virtual.sim import simulate
from sim_plant.physics.stage import Truth
from tests.support.paths import RIGS

PAPER = RIGS / "paper.toml"
STRUCTURED = "law.name=structured-kalman"
RASTER = ["task.kind=raster", "task.axes=['x', 'y']", "task.corner=[0.0, 0.0]", "task.size=[5e-3, 1e-3]"]
ZIGZAG = [[0.0, 0.0], [0.01, 0.002], [0.0, 0.004], [0.01, 0.006]]
EARLY = ["task.approach_s=0.2", "task.settle_s=0.0"]


def wave(path: Path, rows: int = 200) -> Path:
    """A CSV of one second: y goes to and fro, x follows a quarter as far."""
    t = np.linspace(0.0, 1.0, rows)
    y = 0.01 * np.sin(np.pi * t) ** 2
    text = "time_s, y, x\n" + "\n".join(f"{a!r},{b!r},{b / 4!r}" for a, b in zip(t.tolist(), y.tolist(), strict=True))
    path.write_text(text + "\n")
    return path


def trajectory(rig: RigConfig, start: tuple[float, float] = (0.0, 0.0)) -> Trajectory:
    return make_trajectory(rig.task, rig.axis_names, start, rig.period_ns)


def path_rig(path: Path, *more: str) -> RigConfig:
    return load_rig(PAPER, ["task.kind=path", f"task.file={path}", *EARLY, *more])


@pytest.mark.parametrize("kind", ["csv", "npz"])
def test_a_file_is_followed_through_its_points(kind: str, tmp_path: Path) -> None:
    path = wave(tmp_path / "wave.csv")
    axes, rows = read_task_file(path)
    assert axes == ["y", "x"]
    if kind == "npz":
        table = np.array(rows)
        path = tmp_path / "wave.npz"
        np.savez(path, time_s=table[:, 0], y=table[:, 1], x=table[:, 2])
    rig = path_rig(path)
    run = trajectory(rig, (0.3, -0.1))
    assert run.duration_ns == 1_200_000_000
    for time, y, x in rows:
        at = 200_000_000 + round(time * 1e9)
        assert run.at(0, at)[0] == pytest.approx(x, abs=1e-15)
        assert run.at(1, at)[0] == pytest.approx(y, abs=1e-15)
    assert run.at(0, 0) == (0.3, 0.0, 0.0)
    assert run.at(1, 1 << 50) == (rows[-1][1], 0.0, 0.0)


@given(
    st.lists(st.tuples(st.floats(1e-3, 0.5), st.floats(-1.0, 1.0)), min_size=1, max_size=30),
    st.booleans(),
)
@settings(max_examples=50, deadline=None)
def test_a_spline_is_smooth_up_to_its_acceleration(steps: list[tuple[float, float]], repeat: bool) -> None:
    rows, time = [[0.0, 0.0]], 0.0
    for step, position in steps:
        time += step
        rows.append([time, position])
    if repeat:
        rows.append([time + 0.1, 0.0])
    path = spline(rows, repeat=repeat)
    looks = [row[0] + part * (after[0] - row[0]) for row, after in pairwise(rows) for part in (0.0, 0.2, 0.5, 0.8)]
    largest = max(abs(path.at(0, round(time * 1e9))[2]) for time in looks)
    for row in rows[1:-1]:
        at = round(row[0] * 1e9)
        (q0, v0, a0), (q1, v1, a1) = path.at(0, at - 1), path.at(0, at)
        assert q0 == pytest.approx(q1, abs=1e-9 + 2e-9 * abs(v1))
        assert v0 == pytest.approx(v1, abs=1e-6 * (1.0 + largest))
        a_by_now = 2.0 * a0 - path.at(0, at - 2)[2]
        assert a_by_now == pytest.approx(a1, abs=1e-4 * (1.0 + largest))
        assert q1 == pytest.approx(row[1], abs=1e-9)
    times = np.array([round(row[0] * 1e9) for row in rows[:-1]] * 20, dtype=np.int64)[:, None]
    many, few = path.sample(times), [path.at(0, t) for t in times[:, 0].tolist()]
    assert [
        tuple(row) for row in zip(many.position[:, 0], many.velocity[:, 0], many.acceleration[:, 0], strict=True)
    ] == few


def test_waypoints_are_reached_within_the_limits() -> None:
    points = [[0.0, 0.0], [0.02, 0.01], [0.02, 0.01], [-0.01, 0.03]]
    rig = load_rig(
        PAPER,
        ["task.kind=waypoints", "task.axes=['x', 'y']", f"task.waypoints={points}", "task.speed=0.05",
         "task.acceleration=0.5", "task.jerk=50.0", "task.dwell_s=0.1", *EARLY],
    )  # fmt: skip
    run = trajectory(rig)
    assert run.duration_ns is not None
    times = np.arange(200_000_000, run.duration_ns + 1, 500_000, dtype=np.int64)
    sampled = run.sample(np.repeat(times[:, None], 2, axis=1))
    assert np.abs(sampled.velocity).max() <= 0.05 * (1 + 1e-9)
    assert np.abs(sampled.acceleration).max() <= 0.5 * (1 + 1e-9)
    assert np.abs(np.diff(sampled.acceleration, axis=0) / 5e-4).max() <= 50.0 * (1 + 1e-3)
    assert max(np.abs(sampled.velocity).max() / 0.05, np.abs(sampled.acceleration).max() / 0.5) > 0.9
    for point in points:
        assert np.abs(sampled.position - point).sum(axis=1).min() < 1e-12
    assert (sampled.position[-1] == points[-1]).all()


@pytest.mark.parametrize("blend", [0.0, 1e-3])
def test_points_that_repeat_end_where_they_begin_whether_the_way_back_is_said_or_not(blend: float) -> None:
    limits = (0.05, 0.5, 50.0)
    a, b, c = [0.0, 0.01], [0.02, 0.01], [0.02, -0.01]

    def around(*points: list[float]) -> Segments:
        closed = apart(points, [0.0, 0.0], repeat=True)
        return waypoints(closed, limits, lambda s: max(round(s * 1e3), 1) * 1_000_000, 10_000_000, blend, repeat=True)

    for said, unsaid in (((a, b, a), (a, b)), ((a, b, c, a), (a, b, c)), ((a, a, b, a), (a, a, b))):
        assert around(*said).segments == around(*unsaid).segments
        last = around(*unsaid)
        assert last.repeat_ns is not None
        assert [last.at(axis, last.repeat_ns - 1)[0] for axis in (0, 1)] == pytest.approx(a, abs=1e-12)


@pytest.mark.parametrize("tight", range(3), ids=["speed", "acceleration", "jerk"])
def test_a_move_between_waypoints_is_as_quick_as_its_tightest_limit_allows(tight: int) -> None:
    limits = [(0.02, 100.0, 1e6), (100.0, 0.1, 1e6), (100.0, 100.0, 2.0)][tight]
    move = waypoints([[0.0, 0.01], [0.02, 0.01]], limits, lambda seconds: round(seconds * 1e9), 0, 0.0, repeat=False)
    assert move.duration_ns is not None
    times = np.linspace(0, move.duration_ns, 4001).astype(np.int64)
    sampled = move.sample(np.repeat(times[:, None], 2, axis=1))
    jerk = np.abs(np.diff(sampled.acceleration, axis=0)).max() / (move.duration_ns / 4000 * 1e-9)
    reached = (np.abs(sampled.velocity).max(), np.abs(sampled.acceleration).max(), jerk)
    assert reached[tight] == pytest.approx(limits[tight], rel=3e-3)
    assert all(value <= limit * 1.001 for value, limit in zip(reached, limits, strict=True))


def test_a_spiral_turns_outwards_and_rests_at_both_ends() -> None:
    rig = load_rig(
        PAPER,
        ["task.kind=spiral", "task.axes=['y', 'x']", "task.radius=0.01", "task.turns=4", "task.move_s=2.0", *EARLY],
    )
    run = trajectory(rig)
    times = 200_000_000 + np.arange(0, 2_000_000_001, 1_000_000, dtype=np.int64)
    sampled = run.sample(np.repeat(times[:, None], 2, axis=1))
    radius = np.hypot(sampled.position[:, 0], sampled.position[:, 1])
    assert radius[0] == pytest.approx(0.0, abs=1e-12)
    assert radius[-1] == pytest.approx(0.01)
    assert (np.diff(radius) > -1e-9).all()
    assert sampled.velocity[[0, -1]] == pytest.approx(np.zeros((2, 2)), abs=1e-12)
    angle = np.unwrap(np.arctan2(sampled.position[100:, 0], sampled.position[100:, 1]))
    assert 3.0 < (angle[-1] - angle[0]) / (2 * np.pi) < 4.01


@pytest.mark.long
@pytest.mark.parametrize("kind", ["path", "waypoints", "blend", "spline", "raster", "spiral"])
def test_a_path_is_followed_to_a_micrometre_and_a_batch_is_the_same(kind: str, tmp_path: Path) -> None:
    own = {
        "path": [f"task.file={wave(tmp_path / 'w.csv')}"],
        "waypoints": ["task.axes=['x']", "task.waypoints=[[0.0], [0.01]]", "task.repeat=true"],
        "blend": ["task.axes=['x', 'y']", f"task.waypoints={ZIGZAG}", "task.blend=1e-3", "task.repeat=true"],
        "spline": ["task.axes=['x', 'y']", f"task.waypoints={ZIGZAG}", "task.dwell_s=0.1", "task.repeat=true"],
        "raster": ["task.axes=['x', 'y']", "task.corner=[0.0, 0.0]", "task.size=[5e-3, 1e-3]", "task.blend=1e-4"],
        "spiral": ["task.axes=['x', 'y']", "task.radius=0.005", "task.repeat=true"],
    }[kind]
    kind = "waypoints" if kind == "blend" else kind
    rig = load_rig(PAPER, [f"task.kind={kind}", *own, *EARLY, STRUCTURED, "wire.stuffing=worst"])
    report, _ = simulate(rig, RIGS, 1.0)
    assert (report.state, report.faults) == ("ACTIVE", {})
    assert max(axis["max_error"] for axis in report.axes.values()) < 2e-6
    single = LockstepRun(rig, RIGS)
    truth = Truth.from_config(rig.plant, len(rig.axes), rig.axis_names)
    batch = BatchRun(rig, Truth.stack([truth]))
    while single.activated_at < 0:
        single.tick()
    batch.tick()
    for _ in range(300):
        single.tick()
        batch.tick()
        assert batch.force.tolist() == [single.cycle.gate.force]


def test_a_recording_has_the_samples_and_needs_no_file(tmp_path: Path) -> None:
    path = wave(tmp_path / "wave.csv")
    rig = path_rig(path)
    recorder = LockstepRecorder(tmp_path / "run.mcap", rig, PAPER)
    simulate(rig, RIGS, 0.6, observer=recorder.observe)
    recorder.close()
    before = rig_hash(rig)
    path.unlink()
    report = replay_run(tmp_path / "run.mcap")
    assert (report.ticks, report.different) == (600, 0)
    assert rig_hash(build_rig(rig.model_dump(mode="json"))) == before
    assert rig_hash(path_rig(wave(path, 100))) != before


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (["task.kind=path"], "samples: 0 rows: expected from 2"),
        (["task.kind=path", "task.file=none.csv"], "none.csv: No such file"),
        (["task.kind=waypoints"], "needs `axes` and from 2"),
        (["task.kind=waypoints", "task.axes=['x']", "task.waypoints=[[0.0], [0.0, 1.0]]"], "row 2 has 2 values for"),
        (["task.kind=waypoints", "task.axes=['x']", "task.waypoints=[[0.0], [2.0]]"], "row 2, column x: 2 is outside"),
        (["task.kind=waypoints", "task.axes=['x', 'x']", "task.waypoints=[[0.0, 0.0], [0.1, 0.1]]"], "an axis twice"),
        (["task.kind=spiral", "task.axes=['x']"], "a spiral needs two axes"),
        (["task.kind=spline"], "kind = 'spline' needs `axes` and from 2"),
        (["task.kind=spline", "task.axes=['x']", "task.waypoints=[[0.0], [0.0]]"], "every row is row 1 again"),
        (["task.kind=raster", "task.axes=['x', 'y']"], "kind = 'raster' needs `corner` with 2 values; it has 0"),
        ([*RASTER, "task.axes=['x']"], "a raster needs two axes"),
        ([*RASTER, "task.size=[0.0, 1e-3]"], "size = [0.0, 0.001]: allowed: two numbers other than 0"),
        ([*RASTER, "task.size=[9.0, 1e-3]"], "task.size: row 2, column x: 9 is outside axes.x.limits.position"),
        ([*RASTER, "task.lines=1"], "task.lines = 1: Input should be greater than or equal to 2"),
        ([*RASTER, "task.blend=-1e-3"], "task.blend = -0.001: Input should be"),
        ([*RASTER, "task.jerk=0"], "task.jerk = 0: Input should be"),
    ],
)  # fmt: skip
def test_a_task_that_is_not_complete_is_refused(changes: list[str], text: str) -> None:
    with pytest.raises(RigError) as caught:
        load_rig(PAPER, changes)
    assert text in str(caught.value)


LIMITS = st.tuples(st.floats(1e-3, 0.5), st.floats(1e-2, 10.0), st.floats(1.0, 1e4))
PLACES = st.integers(-2000, 2000).map(lambda value: value * 1e-5)


@st.composite
def bodies(draw: st.DrawFn) -> tuple[TaskConfig, Trajectory]:
    """Any raster, spline or waypoints, and how they go on once their first point is reached."""
    kind = draw(st.sampled_from(["waypoints", "spline", "raster"]))
    speed, acceleration, jerk = draw(LIMITS)
    points = draw(st.lists(st.lists(PLACES, min_size=2, max_size=2), min_size=2, max_size=8))
    points = [p for i, p in enumerate(points) if not i or p != points[i - 1]]
    task = TaskConfig(
        kind=kind, axes=["x", "y"], waypoints=points if len(points) > 1 else [[0.0, 0.0], [1e-3, 0.0]],
        speed=speed, acceleration=acceleration, jerk=jerk, dwell_s=draw(st.sampled_from([0.0, 0.02])),
        corner=[draw(PLACES), 0.0], size=[draw(st.sampled_from([-2e-3, 1e-4])), draw(st.sampled_from([-1e-4, 3e-3]))],
        lines=draw(st.integers(2, 5)), blend=draw(st.sampled_from([0.0, 1e-9, 1e-4, 1.0])), repeat=draw(st.booleans()),
        approach_s=0.001,
    )  # fmt: skip
    begin = task.corner if kind == "raster" else task.waypoints[0]
    return task, make_trajectory(task, ["x", "y"], begin, 1_000_000)


@given(bodies())
@settings(max_examples=60, deadline=None)
def test_what_is_accepted_is_smooth_and_keeps_its_limits(given_body: tuple[TaskConfig, Trajectory]) -> None:
    """Between instants 1/4000 of the whole apart nothing changes by more than the next derivative's limit allows. The
    approach to what is already in motion has its own time.
    """
    task, run = given_body
    end = run.duration_ns if run.repeat_ns is None else run.repeat_from_ns + 2 * run.repeat_ns
    assert end is not None
    assert end % 1_000_000 == 0
    begin = run.repeat_from_ns if run.repeat_ns is not None else 0
    times = np.unique(np.linspace(begin, end, 4001).astype(np.int64))
    sampled = run.sample(np.repeat(times[:, None], 2, axis=1))
    step = np.diff(times)[:, None] * 1e-9
    for values, limit, change in (
        (sampled.position, np.inf, task.speed),
        (sampled.velocity, task.speed, task.acceleration),
        (sampled.acceleration, task.acceleration, task.jerk),
    ):
        assert np.abs(values).max() <= limit * (1 + 1e-4)
        assert (np.abs(np.diff(values, axis=0)) <= change * step * (1 + 1e-4) + 1e-9 * change).all()
    few = [[run.at(axis, t) for axis in range(2)] for t in times[::97].tolist()]
    many = np.stack([sampled.position, sampled.velocity, sampled.acceleration], axis=-1)[::97]
    assert many.tolist() == [[list(motion) for motion in row] for row in few]
    assert [run.at(axis, 0)[1:] for axis in range(2)] == [(0.0, 0.0), (0.0, 0.0)]


@given(bodies())
@settings(max_examples=40, deadline=None)
def test_points_are_passed_within_the_blend(given_body: tuple[TaskConfig, Trajectory]) -> None:
    task, run = given_body
    points = task.waypoints
    if task.kind == "raster":
        points = raster_points(task.corner, task.size, task.lines)
        assert len(points) == 2 * task.lines
    end = horizon(run)
    times = np.unique(np.linspace(run.repeat_from_ns, end, 8001).astype(np.int64))
    positions = run.sample(np.repeat(times[:, None], 2, axis=1)).position
    reach = task.speed * 2**0.5 * (end * 1e-9) / 8000 + 1e-9
    for point in points:
        away = np.hypot(*(positions - point).T).min()
        assert away <= (task.blend if task.kind != "spline" else 0.0) + reach


def test_a_blend_is_quicker_than_a_rest_at_every_point() -> None:
    bow = [[0.02 * np.sin(k / 5), 0.02 * np.cos(k / 5)] for k in range(10)]
    own = ["task.kind=waypoints", "task.axes=['x', 'y']", f"task.waypoints={np.array(bow).tolist()}", *EARLY]
    own.append("task.dwell_s=0.0")
    lasts = [horizon(trajectory(load_rig(PAPER, [*own, f"task.blend={blend}"]))) for blend in (0.0, 1e-4, 2e-3)]
    assert lasts[2] < 0.6 * lasts[0]
    assert lasts[2] < lasts[1] < lasts[0]


def test_a_spiral_that_repeats_goes_back_the_way_it_came() -> None:
    own = ["task.kind=spiral", "task.axes=['x', 'y']", "task.radius=0.01", "task.move_s=2.0", "task.repeat=true"]
    run = trajectory(load_rig(PAPER, [*own, *EARLY]))
    assert (run.repeat_from_ns, run.repeat_ns) == (200_000_000, 4_000_000_000)
    for t in range(10_000_000, 2_000_000_000, 35_000_000):
        there, back = (run.at(0, 200_000_000 + when) for when in (t, 4_000_000_000 - t))
        assert (there[0], there[1]) == (pytest.approx(back[0], abs=1e-13), pytest.approx(-back[1], abs=1e-11))


def test_a_path_that_repeats_must_end_where_it_began() -> None:
    def rig(last: float) -> RigConfig:
        samples = [[0.0, 0.01, 0.0], [1.0, 0.02, 0.01], [2.0, 0.01, last]]
        task = ["task.kind=path", "task.axes=['x', 'y']", f"task.samples={samples}", "task.repeat=true"]
        return load_rig(PAPER, task)

    assert rig(0.0).task.repeat
    with pytest.raises(RigError, match=r"row 3 of task\.samples must have the positions of row 1"):
        rig(1e-3)
