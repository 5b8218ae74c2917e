"""Another task for a rig: the table [task] of a TOML file, or the path of a CSV or NPZ file, and nothing else of it."""

from pathlib import Path

import numpy as np
import pytest

from hil.rig.file import load_rig, task_of_file
from hil.rig.schema import RigError
from tests.support.paths import RIGS

RIG = load_rig(RIGS / "paper.toml")
PATH = "time_s,y\n0,0.0\n1,0.01\n"


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_of_a_rig_file_the_task_is_taken_and_all_else_left(tmp_path: Path) -> None:
    path = written(tmp_path, "other.TOML", 'rate_hz = 1\n[task]\nkind = "circle"\naxes = ["x", "y"]\nradius = 0.02\n')
    task = task_of_file(RIG, path, ["task.frequency_hz=0.25"])
    assert (task.kind, task.axes, task.radius, task.frequency_hz) == ("circle", ["x", "y"], 0.02, 0.25)


def test_a_file_of_samples_is_a_path_wherever_it_lies(tmp_path: Path) -> None:
    task = task_of_file(RIG, written(tmp_path, "line.csv", PATH), ["task.approach_s=0.5"])
    assert (task.kind, task.axes, task.samples, task.approach_s) == ("path", ["y"], [[0.0, 0.0], [1.0, 0.01]], 0.5)
    assert task.file == "line.csv"
    np.savez(tmp_path / "line.npz", time_s=[0.0, 1.0], x=[0.0, 0.02])
    assert task_of_file(RIG, tmp_path / "line.npz").samples == [[0.0, 0.0], [1.0, 0.02]]


@pytest.mark.parametrize(
    ("name", "text", "overrides", "reason"),
    [
        ("none.toml", None, [], "none.toml: No such file or directory"),
        ("none.csv", None, [], "none.csv: task.file: "),
        ("bad.toml", "[task", [], "bad.toml: "),
        ("other.toml", "rate_hz = 500\n", [], "other.toml: there is no table [task]"),
        ("line.csv", PATH, ["rate_hz=500"], "--set 'rate_hz=500': only keys of [task] can be chosen here"),
        ("line.csv", PATH, ["task.settle_s=0", "law.name=pid"], "--set 'law.name=pid': only keys of [task]"),
        ("line.csv", PATH, ["task.settle_s=-1"], "line.csv: task.settle_s = -1: "),
        ("line.csv", PATH.replace("y", "q"), [], "line.csv: rig: task.axes: no axis 'q'"),
    ],
)
def test_what_is_no_task_is_refused_by_file_and_key(
    name: str, text: str | None, overrides: list[str], reason: str, tmp_path: Path
) -> None:
    path = tmp_path / name if text is None else written(tmp_path, name, text)
    with pytest.raises(RigError) as caught:
        task_of_file(RIG, path, overrides)
    assert reason in str(caught.value)
