"""Files of what a law has learnt: read as they were written, refused by name and key, and never read beyond a bound."""

import json
from pathlib import Path
from typing import Any

import pytest

from hil.rig import learnt_file
from hil.rig.file import build_rig, learning_hash, learning_hashes, load_rig
from hil.rig.learnt_file import LearntFileError, read_learnt_file, read_states, write_learnt_file
from hil.rig.schema import RigConfig, RigError
from tests.support.paths import RIGS

STATE = {"x": [1.0, -0.5], "y": [0.25, 0.0]}
HASHES = {"x": "aa", "y": "bb"}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "learnt.json"


def test_it_is_read_as_it_was_written(path: Path) -> None:
    write_learnt_file(path, "paper", "0123abcd", HASHES, STATE)
    assert read_learnt_file(path, ["x", "y"]) == ("0123abcd", [[1.0, -0.5], [0.25, 0.0]])
    assert read_learnt_file(path, ["y"]) == ("0123abcd", [[0.25, 0.0]])
    assert json.loads(path.read_text()) == {"rig": "paper", "rig_hash": "0123abcd", "axes": HASHES, "state": STATE}


def test_axes_are_read_that_have_the_hash_they_were_learnt_on(path: Path) -> None:
    write_learnt_file(path, "paper", "0123abcd", HASHES, STATE)
    assert read_states(path, HASHES) == STATE
    assert read_states(path, {"x": "aa", "y": "other"}) == {"x": STATE["x"]}
    assert read_states(path, {"z": "aa"}) == {}
    path.write_text(json.dumps({"rig_hash": "0", "state": STATE}))
    assert read_states(path, HASHES) == {}
    path.write_text(json.dumps({"axes": HASHES, "state": {"x": [float("nan")]}}))
    with pytest.raises(LearntFileError, match=r"state\.x: expected a list of finite numbers"):
        read_states(path, HASHES)


def test_a_file_of_just_the_bound_is_read_and_one_byte_more_is_not(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_learnt_file(path, "paper", "0123abcd", HASHES, STATE)
    size = path.stat().st_size
    monkeypatch.setattr(learnt_file, "LARGEST", size)
    assert read_learnt_file(path, ["x"])[1] == [[1.0, -0.5]]
    monkeypatch.setattr(learnt_file, "LARGEST", size - 1)
    with pytest.raises(LearntFileError, match=f"no file of `hil learnt`: .* at most {size - 1} bytes"):
        read_learnt_file(path, ["x"])


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"state": []}', "[" * 100_000])
def test_what_is_no_such_file_is_refused_by_name(text: str, path: Path) -> None:
    path.write_text(text)
    with pytest.raises(LearntFileError, match=r"learnt\.json: no file of `hil learnt`"):
        read_learnt_file(path, ["x"])


def test_a_missing_file_is_refused_by_name(path: Path) -> None:
    with pytest.raises(LearntFileError, match=r"learnt\.json: No such file or directory"):
        read_learnt_file(path, ["x"])


@pytest.mark.parametrize("values", [None, 1.0, [True], ["1"], [1e100], [-1e100], [float("nan")], [float("inf")]])
def test_values_that_are_no_list_of_finite_numbers_are_refused_by_axis(values: Any, path: Path) -> None:
    path.write_text(json.dumps({"rig_hash": "0", "state": {"x": [0.0], "y": values}}))
    assert read_learnt_file(path, ["x"])[1] == [[0.0]]
    with pytest.raises(LearntFileError, match=r"state\.y: expected a list of finite numbers"):
        read_learnt_file(path, ["x", "y"])


def test_axes_of_different_lengths_are_refused(path: Path) -> None:
    path.write_text(json.dumps({"state": {"x": [0.0], "y": [0.0, 1]}}))
    assert read_learnt_file(path, ["y"]) == ("None", [[0.0, 1.0]])
    with pytest.raises(LearntFileError, match="axes of different lengths"):
        read_learnt_file(path, ["x", "y"])


def test_a_rig_takes_what_was_learnt_on_it_and_no_other_while_it_learns(path: Path) -> None:
    def rig(*changes: str) -> RigConfig:
        return load_rig(path.parent / "rig.toml", ["law.name=presliding-kalman", *changes])

    (path.parent / "rig.toml").write_text((RIGS / "paper.toml").read_text())
    learning, learnt = "law.iterative_learning=true", "law.learnt=learnt.json"
    write_learnt_file(path, "paper", learning_hash(rig(learning)), HASHES, STATE)
    assert rig(learning, learnt).law.learnt_state == [STATE["x"], STATE["y"]]
    with pytest.raises(RigError, match=r"law\.learnt = 'learnt\.json': learnt on another rig \(hash "):
        rig(learnt)  # which learns no repeats
    with pytest.raises(RigError, match=r"law\.learnt = 'learnt\.json': learnt on another rig \(hash "):
        rig(learning, learnt, "task.radius=0.01")


@pytest.mark.parametrize(
    ("change", "others"),
    [
        ("task.radius=0.01", set()),
        ("axes.x.motion.speed=0.001", set()),
        ("axes.x.limits.following_error=0.004", set()),
        ("axes.y.model.mass=0.03", {"y"}),
        ("axes.x.limits.force=4.0", {"x"}),
        ("axes.x.offset=0.001", {"x"}),
        ("law.gains.integral=[0.05, 0.1]", {"x", "y"}),
        ("rate_hz=500", {"x", "y"}),
        ("law.name=pd-feedforward", {"x", "y"}),
        ("law.iterative_learning=true", {"x", "y"}),
    ],
)
def test_what_a_law_learns_depends_on_its_axis_law_and_rate_and_on_no_task(change: str, others: set[str]) -> None:
    plain = load_rig(RIGS / "paper.toml", ["law.name=presliding-kalman"])
    changed = load_rig(RIGS / "paper.toml", ["law.name=presliding-kalman", change])
    own, new = learning_hashes(plain), learning_hashes(changed)
    assert {axis for axis in own if own[axis] != new[axis]} == others
    assert (learning_hash(plain) == learning_hash(changed)) == (not others)


def test_gains_of_one_axis_are_another_rig_to_that_axis_alone() -> None:
    def hashes(integral: str) -> dict[str, str]:
        sets = ["law.name=presliding-kalman", f"law.gains.integral={integral}"]
        return learning_hashes(load_rig(RIGS / "paper.toml", sets))

    first, second = hashes("[0.05, 0.1]"), hashes("[0.05, 0.2]")
    assert first["x"] == second["x"]
    assert first["y"] != second["y"]


def test_what_a_rig_file_names_is_read_and_what_a_recording_holds_is_not_read_again(path: Path) -> None:
    """A replay needs no file; who chooses one gets it."""
    rig_file = path.parent / "rig.toml"
    text = (RIGS / "paper.toml").read_text()
    named = 'learnt = "learnt.json"\niterative_learning = true\nname = "presliding-kalman"'
    rig_file.write_text(text.replace('name = "pd-feedforward"', named, 1))
    plain = load_rig(RIGS / "paper.toml", ["law.name=presliding-kalman", "law.iterative_learning=true"])
    write_learnt_file(path, "paper", learning_hash(plain), HASHES, STATE)
    rig = load_rig(rig_file)
    assert rig.law.learnt_state == [STATE["x"], STATE["y"]]
    document = rig.model_dump(mode="json")
    write_learnt_file(path, "paper", learning_hash(plain), HASHES, {"x": [2.0, 2.0], "y": [3.0, 3.0]})
    assert build_rig(document, folder=path.parent).law.learnt_state == [STATE["x"], STATE["y"]]
    again = build_rig(document, ["law.learnt=learnt.json"], folder=path.parent)
    assert again.law.learnt_state == [[2.0, 2.0], [3.0, 3.0]]
