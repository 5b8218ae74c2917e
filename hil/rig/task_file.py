"""Files of a task's samples: CSV or NPZ, with the time and the position of every axis that moves.

A CSV file has a header line, `time_s` and the axes' names, and numbers below; an NPZ file has arrays of those names.
Times are in s, positions in m (rad).
"""

import csv
import io
import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from drivers.base.text_file import UnsuitableFileError, read_bounded, words_of
from drivers.base.toml_file import short

TIME = "time_s"
MOST_ROWS = 20_000
MOST_COLUMNS = 64
LARGEST = 2**23  # bytes, of the file and of what an NPZ file unfolds to
Rows = list[list[float]]


class TaskFileError(ValueError):
    """A file that holds no task; the text names file, row and column."""


def read_task_file(path: Path) -> tuple[list[str], Rows]:
    """The axes a file names, and its rows: time, then positions in their order. Raises TaskFileError."""
    data = file_bytes(path)
    axes, rows = (_from_npz if path.suffix.lower() == ".npz" else _from_csv)(path, data)
    problems = sample_problems(axes, rows)
    if problems:
        raise TaskFileError("\n".join(f"{path}: {problem}" for problem in problems))
    return axes, rows


def file_bytes(path: Path) -> bytes:
    """All of a file of at most LARGEST bytes. Raises TaskFileError."""
    try:
        return read_bounded(path, LARGEST)
    except OSError as error:
        raise TaskFileError(f"{path}: {words_of(error)}") from None
    except UnsuitableFileError as error:
        raise TaskFileError(f"{path}: {error}") from None


def sample_problems(axes: Sequence[str], rows: Sequence[Sequence[float]]) -> list[str]:
    """What keeps rows of time and positions from being a task; rows are counted from 1, without a header."""
    if not axes:
        return ["no axis: expected a column of positions beside the time"]
    if not 2 <= len(rows) <= MOST_ROWS:
        return [f"{len(rows)} rows: expected from 2 to {MOST_ROWS}"]
    names = [TIME, *axes]
    for number, row in enumerate(rows, 1):
        if len(row) != len(names):
            return [f"row {number}: {len(row)} values, expected {len(names)} ({', '.join(names)})"]
        for name, value in zip(names, row, strict=True):
            if not math.isfinite(value) or abs(value) > 1e6:
                return [f"row {number}, column {name}: {value}: expected a finite number within 1e6"]
    for number, (before, after) in enumerate(pairwise(rows), 2):
        if after[0] - before[0] < 1e-6:
            return [f"row {number}, column {TIME}: {after[0]} s is not after {before[0]} s of the row before"]
    return []


def _from_csv(path: Path, data: bytes) -> tuple[list[str], Rows]:
    names, rows = csv_columns(path, data, lambda header: [TIME, *_columns(path, header)])
    return names[1:], rows


def csv_columns(
    path: Path, data: bytes, chosen: Callable[[Sequence[str]], list[str]], most: int = MOST_ROWS
) -> tuple[list[str], Rows]:
    """Columns of numbers of a CSV file with a header line, and their names. chosen: of the header's names those that
    are read, in the order of each row. most: rows. Raises TaskFileError naming file, row and column.
    """
    try:
        lines = csv.reader(io.StringIO(data.decode("utf-8-sig"), newline=""), skipinitialspace=True)
        header = [name.strip() for name in next(lines, [])]
        names = chosen(header)
        places = [header.index(name) for name in names]
        rows: Rows = []
        for line in lines:
            if not any(cell.strip() for cell in line):
                continue
            if len(rows) == most:
                raise TaskFileError(f"{path}: more than {most} rows")
            rows.append(_numbers(path, len(rows) + 1, header, line, places))
    except (UnicodeDecodeError, csv.Error) as error:
        raise TaskFileError(f"{path}: no CSV file: {error}") from None
    return names, rows


def _numbers(path: Path, number: int, header: Sequence[str], line: Sequence[str], places: Sequence[int]) -> list[float]:
    if len(line) != len(header):
        raise TaskFileError(f"{path}: row {number}: {len(line)} values, expected {len(header)} ({', '.join(header)})")
    found = []
    for place in places:
        try:
            found.append(float(line[place]))
        except ValueError:
            raise TaskFileError(
                f"{path}: row {number}, column {header[place]}: {line[place][:40]!r} is no number"
            ) from None
    return found


def _from_npz(path: Path, data: bytes) -> tuple[list[str], Rows]:
    import numpy as np

    from hil.rig.npz_file import read_arrays

    try:
        archive = read_arrays(io.BytesIO(data), LARGEST)
        arrays = {name: np.asarray(array, dtype=np.float64) for name, array in archive.items()}
    except (ValueError, TypeError, OverflowError) as error:
        raise TaskFileError(f"{path}: no NPZ file of numbers: {short(str(error))}") from None
    axes = _columns(path, list(arrays))
    for name, array in arrays.items():
        if array.shape != arrays[TIME].shape or array.ndim != 1:
            raise TaskFileError(f"{path}: {short(name)} has the shape {array.shape}, {TIME} {arrays[TIME].shape}")
    if arrays[TIME].size > MOST_ROWS:
        raise TaskFileError(f"{path}: more than {MOST_ROWS} rows")
    found: Any = np.stack([arrays[name] for name in (TIME, *axes)], axis=1).tolist()
    return axes, found


def _columns(path: Path, header: Sequence[str]) -> list[str]:
    if len(header) > MOST_COLUMNS:
        raise TaskFileError(f"{path}: {len(header)} columns: at most {MOST_COLUMNS}")
    if TIME not in header:
        raise TaskFileError(f"{path}: no column {TIME}; there are {short(', '.join(header)) or 'none'}")
    if len(set(header)) != len(header):
        raise TaskFileError(f"{path}: a column twice: {short(', '.join(header))}")
    return [name for name in header if name != TIME]
