"""Paths do what their rows say: rests are rests, what repeats runs through, and every excursion is told."""

import json
import random
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from hil.analysis.task_figures import excursion_notes, excursion_problems, task_excursions, task_figures
from hil.control.trajectories import make_trajectory
from hil.control.trajectories.blends import lines
from hil.control.trajectories.paths import AlongPath, apart
from hil.control.trajectories.paths import Path as JoinedPath
from hil.control.trajectories.rows import BETWEEN, along_rows, excursions
from hil.operate.check import check_rig
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from tests.benchmarks.path_files import file_of
from tests.support.paths import RIGS

PAPER = RIGS / "paper.toml"
DWELL = [[0.0, 0.0], [1.0, -0.003], [2.0, -0.003], [3.0, 0.0], [4.0, 0.0]]
STAIRS = [[float(t), q] for t, q in enumerate([0.0, 1e-3, 1e-3, 1e-3, 2e-3, 2e-3, 2e-3, 0.0, 0.0])]
ZIGZAG = [[0.0, 0.0], [0.5, 1e-3], [1.0, 4e-3], [1.5, 2e-3], [2.0, 0.0]]
MS = 1_000_000


def random_rows(seed: int) -> list[list[float]]:
    """Four axes: rests, steps, circles and noise, 2 to 200 rows."""
    draw, n = random.Random(seed), random.Random(seed).randrange(2, 201)
    time, rows, radius = 0.0, [], draw.random() * 1e-3
    here = [0.0, 0.0, 0.0, 0.0]
    for k in range(n):
        angle = 0.1 * k
        for axis in range(4):
            kind = (seed + axis) % 4
            if kind == 0 and draw.random() < 0.5:
                here[axis] = draw.random() * 1e-3
            elif kind == 1:
                here[axis] = radius * (np.sin(angle) if axis % 2 else np.cos(angle))
            elif kind == 2:
                here[axis] = round(here[axis] + draw.choice((0.0, 0.0, 1e-4, -1e-4)), 6)
            elif kind == 3:
                here[axis] += (draw.random() - 0.5) * 1e-4
        rows.append([time, *map(float, here)])
        time += draw.choice((1e-3, 0.01, 0.1, 1.0))
    return rows


@pytest.mark.parametrize("between", BETWEEN)
def test_equal_neighbours_are_a_rest_whatever_lies_around_them(between: str) -> None:
    for seed in range(60):
        rows = random_rows(seed)
        body = along_rows(rows, between)
        for index, (part, (before, after)) in enumerate(zip(body.segments, pairwise(rows), strict=False)):
            for column in range(4):
                if before[column + 1] == after[column + 1]:
                    assert part.still[column], (seed, index, column)


@pytest.mark.parametrize("between", BETWEEN)
def test_every_choice_goes_through_its_rows_without_a_jump_of_the_acceleration(between: str) -> None:
    for seed in range(30):
        rows = random_rows(seed)
        body = along_rows(rows, between)
        for before, after in pairwise(body.segments[:-1]):
            h = before.duration_ns * 1e-9
            for column in range(4):
                c0, c1, c2, c3, c4, c5, v2, v3, v4, v5, a2, a3, a4, a5 = before.rows[column]
                last = after.rows[column]
                accelerations = [abs(a2), abs(a2 + h * (a3 + h * (a4 + h * a5))), abs(last[10]), 1e-9]
                assert c0 + h * (c1 + h * (c2 + h * (c3 + h * (c4 + h * c5)))) == pytest.approx(last[0], abs=1e-12)
                speed = c1 + h * (v2 + h * (v3 + h * (v4 + h * v5)))
                assert speed == pytest.approx(last[1], rel=1e-9, abs=1e-9 * max(accelerations) + 1e-12)
                acceleration = a2 + h * (a3 + h * (a4 + h * a5))
                assert acceleration == pytest.approx(last[10], abs=1e-6 * max(accelerations) + 1e-10)


@pytest.mark.parametrize("between", ["blended", "linear"])
def test_no_place_lies_beyond_two_neighbouring_rows_of_a_path_that_is_blended_or_linear(between: str) -> None:
    for seed in range(60):
        rows = random_rows(seed)
        assert excursions(rows, along_rows(rows, between), [1e-12] * 4) == []


def test_excursions_are_all_there_are() -> None:
    """Against many more instants than they are looked for at."""
    for seed in range(20):
        rows = random_rows(seed)
        body = along_rows(rows)
        told = {(x.column, x.row): x.beyond for x in excursions(rows, body, [1e-9] * 4)}
        for index, (before, after) in enumerate(pairwise(rows)):
            part = body.segments[index]
            u = np.linspace(0.0, part.duration_ns * 1e-9, 400)
            for column in range(4):
                place = np.polynomial.polynomial.polyval(u, part.rows[column][:6])
                low, high = sorted((before[column + 1], after[column + 1]))
                beyond = float(max((place - high).max(), (low - place).max(), 0.0))
                if beyond > 1.1e-9:
                    assert beyond * (1.0 - 1e-9) <= told[(column, index + 1)] <= 1.2 * beyond


@pytest.mark.parametrize("between", BETWEEN)
def test_random_files_rest_where_they_say_and_tell_every_excursion(between: str, tmp_path: Path) -> None:
    """The whole way, from the CSV file on; a thousand by `python -m tests.benchmarks.path_files`."""
    found = [file_of(seed, between, tmp_path) for seed in range(4)]
    assert [(one.rest, one.untold, one.overstated) for one in found] == [(0.0, 0, 0)] * 4
    assert (sum(one.told for one in found) > 0) is (between == "smooth")


def path_rig(rows: list[list[float]], *more: str) -> RigConfig:
    return load_rig(PAPER, ["task.kind=path", "task.axes=['x']", f"task.samples={rows}", "task.approach_s=0.5", *more])


@pytest.mark.parametrize("rows", [DWELL, STAIRS])
def test_a_dwell_in_a_file_stays_where_it_says(rows: list[list[float]]) -> None:
    rig = path_rig(rows)
    assert task_excursions(rig) == []
    run = make_trajectory(rig.task, rig.axis_names, [0.0, 0.0], rig.period_ns, rig.counts)
    for before, after in pairwise(rows):
        if before[1] == after[1]:
            for t in np.linspace(before[0], after[0], 50):
                assert run.at(0, 500 * MS + round(t * 1e9))[0] == before[1]


def test_what_goes_beyond_its_rows_is_told_and_refused_above_the_bound() -> None:
    rig = path_rig(ZIGZAG)
    (problem,) = excursion_problems(rig)
    assert "axis x goes" in problem
    assert "beyond rows 3 and 4" in problem or "beyond rows 2 and 3" in problem
    assert excursion_notes(rig)
    assert excursion_problems(path_rig(ZIGZAG, "task.beyond=0.5")) == []
    assert excursion_problems(path_rig(ZIGZAG, "task.between=blended")) == []


def test_check_prints_and_lists_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "check.json"
    changes = ["task.kind=path", "task.axes=['x']", f"task.samples={ZIGZAG}", "task.beyond=0.5"]
    check_rig(PAPER, changes, json_path=str(target), picture=tmp_path / "tick.png")
    assert "um beyond rows" in capsys.readouterr().out
    task = json.loads(target.read_text())["task"]
    assert task["duration_s"] == pytest.approx(4.0)
    assert task["speed"]["axis"] == "x"
    assert {"axis", "row", "beyond", "share"} == set(task["excursions"][0])


def circle(turns: int = 1, rows: int = 201, gap: float = 0.0) -> list[list[float]]:
    angles = np.linspace(0.0, 2.0 * np.pi * turns, rows)
    made = [[4.0 * k / (rows - 1), 0.01 * float(np.sin(a)), 0.01 * float(np.cos(a))] for k, a in enumerate(angles)]
    made[-1][1:] = [made[0][1] + gap, made[0][2] - gap]
    return made


@pytest.mark.parametrize("gap", [0.0, 3e-9])
def test_a_figure_that_repeats_runs_through_its_end(gap: float) -> None:
    """Closed within an encoder count (5 nm here): as smooth there as everywhere."""
    samples = f"task.samples={circle(gap=gap)}"
    rig = load_rig(PAPER, ["task.kind=path", "task.axes=['x', 'y']", samples, "task.repeat=true", "task.approach_s=1"])
    run = make_trajectory(rig.task, rig.axis_names, [0.002, 0.0], rig.period_ns, rig.counts)
    assert run.at(0, 0) == (0.002, 0.0, 0.0)
    ends = [run.at(axis, 5_000 * MS + after) for axis in (0, 1) for after in (-1, 0, 1)]
    assert ends[1][1] == pytest.approx(0.01 * np.pi / 2, rel=1e-3)
    for axis in (0, 3):
        assert ends[axis] == pytest.approx(ends[axis + 1], abs=2e-8)
    for t in range(990, 1010):
        before, at, after = (run.at(0, (t + k) * MS) for k in (-1, 0, 1))
        assert (after[0] - before[0]) / 2e-3 == pytest.approx(at[1], abs=1e-6)
        assert (after[1] - before[1]) / 2e-3 == pytest.approx(at[2], abs=1e-4)
    times = np.arange(0, 6_000, 7, dtype=np.int64) * MS
    many = run.sample(np.repeat(times[:, None], 2, axis=1))
    found = zip(many.position[:, 0], many.velocity[:, 0], many.acceleration[:, 0], strict=True)
    assert list(found) == [run.at(0, int(t)) for t in times]


def test_a_figure_that_repeats_with_a_rest_in_it_is_smooth_across_its_end() -> None:
    rows = [[0.0, 1e-3], [1.0, 2e-3], [2.0, 2e-3], [3.0, 0.0], [4.0, 1e-3]]
    body = along_rows(rows, repeat=True)
    before, after = body.at(0, 4_000 * MS - 1), body.at(0, 4_000 * MS)
    assert after[1] != 0.0
    assert before == pytest.approx(after, abs=1e-8)
    assert body.at(0, 1_500 * MS) == (2e-3, 0.0, 0.0)


def test_points_within_a_count_are_one_point() -> None:
    ulp = [[0.0, 0.0], [0.2, 0.02], [0.20000000000000004, 0.02], [0.1, 0.0]]
    assert apart(ulp, [1e-7, 1e-7], repeat=False) == [ulp[0], ulp[1], ulp[3]]
    lasts = []
    for points in (ulp, [ulp[0], ulp[1], ulp[3]]):
        rig = load_rig(PAPER, ["task.kind=spline", "task.axes=['x', 'y']", f"task.waypoints={points}"])
        lasts.append(task_figures(rig).duration_s)
    assert lasts[0] == lasts[1]
    near = load_rig(PAPER, ["task.kind=spline", "task.axes=['x']", "task.waypoints=[[0.0], [1e-12]]"])
    with pytest.raises(ValueError, match="all rows are one point"):
        task_figures(near)


def test_a_target_next_to_a_limit_is_at_the_limit() -> None:
    limit = load_rig(PAPER).axes["x"].limits.position[1]
    count = load_rig(PAPER).axes["x"].encoder_resolution

    def rig(target: float) -> RigConfig:
        return load_rig(PAPER, ["task.kind=waypoints", "task.axes=['x']", f"task.waypoints=[[0.0], [{target!r}]]"])

    assert rig(limit + 0.4 * count)
    with pytest.raises(RigError, match="is outside"):
        rig(limit + 0.6 * count)


@pytest.mark.parametrize("blend", [0.0, 1e-9, 1e-6, 1e-4, 5e-3])
def test_a_blend_is_never_slower_than_rests(blend: float) -> None:
    draw = random.Random(3)
    for _ in range(20):
        points = [[draw.random() * 0.02, draw.random() * 0.02] for _ in range(6)]
        limits = (0.01 + draw.random(), 0.1 + draw.random(), 1.0 + 100.0 * draw.random())
        lasts = [sum(part.duration_ns for part in lines(points, limits, b, whole)) for b in (0.0, blend)]
        assert lasts[1] <= lasts[0]


def whole(seconds: float) -> int:
    """ns, up to whole periods of a kilohertz."""
    return max(1, -int(-seconds * 1e3 // 1)) * MS


def test_a_path_keeps_its_type_through_the_file_of_a_loaded_task() -> None:
    body = along_rows(circle(), repeat=True)
    plan = AlongPath(body, [0, 1], 200 * MS, 0)
    assert plan([0.0, 0.0]).at(0, 200 * MS)[1] == body.at(0, 0)[1] != 0.0


def test_a_path_begins_at_the_instant_at_which_its_approach_ends() -> None:
    path = JoinedPath(along_rows([[0.0, 0.0], [0.5, 0.01], [1.0, 0.0]], repeat=False), [0], [0.001], 200, 0)
    assert [path.phase_names[path.phase_at(t_ns)] for t_ns in (0, 199, 200, 201)] == ["approach"] * 2 + ["path"] * 2
