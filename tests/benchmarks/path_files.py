"""Random path files against what `check` tells of them: `python -m tests.benchmarks.path_files --files 1000`.

A file of 2 to 200 rows of four axes, with rests, steps, circles and walks, goes the whole way: CSV, rig, plan. The
set-point is then looked at often between every two rows. In a rest it must be the row itself, and every other place
that is beyond the two rows by more than an encoder count must be told, with its row and by how much.
"""

import argparse
import math
import random
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.analysis.task_figures import excursion_problems, task_excursions
from hil.control.trajectories import Trajectory, plan_task
from hil.control.trajectories.rows import BETWEEN
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.rig.shipped import by_name

RIG, AXES = "microscope", ("x", "y", "z", "theta")
APPROACH_NS = 500_000_000
LOOKS, CLOSE_LOOKS = 24, 5000  # places between two rows; where the first see less than is told
OVERSTATED, COUNT_SHARE = 1.01, 0.1  # at most, of what is told over what is seen, which misses the highest place


class Found(NamedTuple):
    """Of one file. rest: most by which the set-point leaves a rest, m. beyond: most beyond two rows, m. told: places
    that are told. untold, overstated: of them, wrong. refused: whether `check` refuses it, above task.beyond.
    """

    rows: int
    rest: float
    beyond: float
    told: int
    untold: int
    overstated: int
    refused: bool


def drawn(seed: int, travel: Sequence[float], speed: Sequence[float]) -> list[list[float]]:
    """Rows: time, s, and four axes within 0.4 of half their travel, m (rad); from row to row at half the speed."""
    draw = random.Random(seed)
    count, turn, time = draw.randrange(2, 201), draw.random(), 0.0
    kinds = [draw.choice(("rest", "step", "circle", "walk")) for _ in AXES]
    here, rows = [0.0] * len(AXES), []
    for k in range(count):
        before = list(here)
        for axis, kind in enumerate(kinds):
            reach = 0.4 * travel[axis]
            if kind == "rest" and draw.random() < 0.3:
                here[axis] = reach * (2.0 * draw.random() - 1.0)
            elif kind == "step":
                here[axis] += draw.choice((0.0, 0.0, 0.01, -0.01)) * reach
            elif kind == "circle":
                here[axis] = 0.5 * reach * math.sin(0.2 * turn * k + axis * math.pi / 2.0)
            elif kind == "walk":
                here[axis] += 0.02 * reach * (draw.random() - 0.5)
            here[axis] = min(max(here[axis], -reach), reach)
        needed = max(2.0 * abs(b - a) / most for a, b, most in zip(before, here, speed, strict=True))
        time += max(draw.choice((0.01, 0.1, 1.0)), 0.01 * math.ceil(100.0 * needed))
        rows.append([time, *here])
    return rows


def written(rows: Sequence[Sequence[float]], file: Path) -> Path:
    """The rows as people write them, with 9 decimals."""
    lines = [",".join([f"{row[0]:.2f}", *(f"{value:.9f}" for value in row[1:])]) for row in rows]
    file.write_text("\n".join([",".join(["time_s", *AXES]), *lines]) + "\n")
    return file


def looked_at(rig: RigConfig) -> Found:
    """The set-point of a rig's path, and what is told of it."""
    rows, counts = np.array(rig.task.samples), np.array(rig.counts)
    shares = np.linspace(0.0, 1.0, LOOKS + 1)
    seconds = rows[:-1, :1] - rows[0, 0] + np.diff(rows[:, 0])[:, None] * shares
    times = APPROACH_NS + np.rint(seconds.ravel() * 1e9).astype(np.int64)
    path = plan_task(rig.task, rig.axis_names, rig.period_ns, rig.counts)(rows[0, 1:].tolist())
    place = path.sample(np.repeat(times[:, None], len(AXES), axis=1)).position.reshape(len(rows) - 1, -1, len(AXES))
    low, high = np.minimum(rows[:-1, 1:], rows[1:, 1:]), np.maximum(rows[:-1, 1:], rows[1:, 1:])
    beyond = np.maximum(place - high[:, None], low[:, None] - place).max(axis=1).clip(0.0)
    told = {(one.row, one.column): one.beyond for one in task_excursions(rig)}
    seen = {(int(row) + 1, int(column)): float(beyond[row, column]) for row, column in np.argwhere(beyond > counts)}
    untold = sum(told.get(where, 0.0) < most * (1.0 - 1e-6) - 1e-3 * counts[where[1]] for where, most in seen.items())
    over = 0
    for (row, column), much in told.items():
        if much > OVERSTATED * beyond[row - 1, column]:
            over += much > OVERSTATED * _closely(path, rows, row - 1, column) + COUNT_SHARE * counts[column]
    rest, most = float(beyond[low == high].max(initial=0.0)), float(beyond.max())
    return Found(len(rows), rest, most, len(told), untold, over, bool(excursion_problems(rig)))


def _closely(path: Trajectory, rows: NDArray[np.float64], row: int, column: int) -> float:
    """Most by which one axis goes beyond two rows, m."""
    first, last = (APPROACH_NS + round((rows[at, 0] - rows[0, 0]) * 1e9) for at in (row, row + 1))
    ends = sorted(rows[row : row + 2, column + 1].tolist())
    places = [path.at(column, first + (last - first) * look // CLOSE_LOOKS)[0] for look in range(CLOSE_LOOKS + 1)]
    return float(max(max(places) - ends[1], ends[0] - min(places), 0.0))


def file_of(seed: int, between: str, folder: Path) -> Found:
    """Draw a file, write it, read it as a rig's task, look at it."""
    rig_file = by_name("rigs", Path(RIG))
    limits = [axis.limits for axis in load_rig(rig_file).axes.values()]
    travel = [0.5 * (one.position[1] - one.position[0]) for one in limits]
    file = written(drawn(seed, travel, [one.speed for one in limits]), folder / "path.csv")
    task = f"task={{kind='path', axes={list(AXES)}, file='{file}', between='{between}', approach_s=0.5, settle_s=0.0}}"
    return looked_at(load_rig(rig_file, [task]))


def main() -> None:
    """Exit status 1: a rest was left, or an excursion was not told."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    words = parser.parse_args()
    found: dict[str, list[Found]] = {between: [] for between in BETWEEN}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(words.files):
            between = BETWEEN[number % len(BETWEEN)]
            found[between].append(file_of(words.seed * 1_000_000 + number, between, Path(folder)))
    for between, files in found.items():
        print(
            f"{between:8} {len(files)} files, {sum(one.rows for one in files)} rows: in rests at most "
            f"{max(one.rest for one in files) * 1e6:.3f} um, beyond two rows at most "
            f"{max(one.beyond for one in files) * 1e6:.3f} um; told {sum(one.told for one in files)}, untold "
            f"{sum(one.untold for one in files)}, overstated {sum(one.overstated for one in files)}; refused "
            f"{sum(one.refused for one in files)} files"
        )
    wrong = any(one.rest or one.untold or one.overstated for files in found.values() for one in files)
    raise SystemExit(int(wrong))


if __name__ == "__main__":
    main()
