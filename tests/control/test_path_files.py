"""What a file or a list of path samples must hold to be a task."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.rig.file import load_rig
from hil.rig.schema import RigError
from hil.rig.task_file import MOST_ROWS, TaskFileError, read_task_file, sample_problems
from tests.support.paths import RIGS

BAD = {
    "": "no column time_s; there are none",
    "time_s\n0\n1\n": "no axis",
    "t,x\n0,0\n": "no column time_s; there are t, x",
    "time_s,x,x\n0,0,0\n": "a column twice",
    "time_s,x\n": "0 rows: expected from 2",
    "time_s,x\n0,0\n": "1 rows: expected from 2",
    "time_s,x\n0,0\n1,a\n": "row 2, column x: 'a' is no number",
    "time_s,x\n0,0\n1,nan\n": "row 2, column x: nan: expected a finite number",
    "time_s,x\n0,0\n1,inf\n": "row 2, column x: inf: expected a finite number",
    "time_s,x\n0,0\n1\n": "row 2: 1 values, expected 2 (time_s, x)",
    "time_s,x\n0,0\n2,0\n1,0\n": "row 3, column time_s: 1.0 s is not after 2.0 s",
    "time_s,x\n0,0\n0,0\n": "row 2, column time_s: 0.0 s is not after 0.0 s",
    "time_s,q\n0,0\n1,0\n": "task.axes: no axis 'q'; the axes are x, y",
    "time_s,x\n0,0\n1,3\n": "task.samples: row 2, column x: 3 is outside axes.x.limits.position",
    "time_s,x\n0,0\n0.001,0.5\n": "task.samples: row 2, column x: 500 /s from the row before, axes.x.limits.speed is 6",
    "time_s,x\n" + "\n".join(f"{k},0" for k in range(MOST_ROWS + 1)): f"more than {MOST_ROWS} rows",
    "\xff": "no CSV file",
}


@pytest.mark.parametrize("text", BAD, ids=[text[:30] or "empty" for text in BAD])
def test_a_file_that_holds_no_task_is_refused_by_row_and_column(text: str, tmp_path: Path) -> None:
    path = tmp_path / "task.csv"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(RigError) as caught:
        load_rig(RIGS / "paper.toml", ["task.kind=path", f"task.file={path}"])
    assert BAD[text] in str(caught.value)


@given(st.binary(max_size=200))
@settings(max_examples=200, deadline=None)
def test_bytes_of_any_kind_are_rows_or_an_error(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    folder = tmp_path_factory.getbasetemp()
    for name, head in (("a.csv", b"time_s,x\n"), ("b.csv", b""), ("c.npz", b"PK\x03\x04")):
        path = folder / name
        path.write_bytes(head + data)
        try:
            axes, rows = read_task_file(path)
        except TaskFileError:
            continue
        assert axes
        assert all(len(row) == 1 + len(axes) for row in rows)


@pytest.mark.parametrize(
    ("taken", "refused"),
    [
        ([[0.0, 0.0], [1e-6, 1.0]], [[0.0, 0.0], [0.99e-6, 1.0]]),
        ([[0.0, 1e6], [1e6, -1e6]], [[0.0, 1e6], [1.0, -1.000001e6]]),
        ([[k, 0.0] for k in range(20_000)], [[k, 0.0] for k in range(20_001)]),
        ([[k, 0.0] for k in range(2)], [[0.0, 0.0]]),
        ([[k, 0.0] for k in range(2)], [[0.0, 0.0], [1.0]]),
    ],
    ids=["a microsecond", "a million", "most rows", "least rows", "as many values as columns"],
)
def test_samples_are_taken_up_to_their_bounds(taken: list[list[float]], refused: list[list[float]]) -> None:
    assert sample_problems(["x"], taken) == []
    assert len(sample_problems(["x"], refused)) == 1


def test_a_file_of_just_the_bound_is_read_and_one_byte_more_is_not(tmp_path: Path) -> None:
    """8 MiB, nearly all of it in lines that hold nothing: a cell has bounds of its own."""
    path, text = tmp_path / "task.csv", "time_s,x\n0,1\n1,2\n"
    lines = (" " * 65535 + "\n") * 128
    path.write_text(text + lines[len(text) :])
    assert path.stat().st_size == 8 << 20
    assert read_task_file(path) == (["x"], [[0.0, 1.0], [1.0, 2.0]])
    path.write_text(text + lines[len(text) - 1 :])
    with pytest.raises(TaskFileError, match=r"task\.csv: "):
        read_task_file(path)
