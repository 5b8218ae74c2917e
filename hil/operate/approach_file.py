"""Approaches of `hil accuracy` as CSV, one row each in the order they were made, so that a column can stand
beside them: what a reference instrument (laser interferometer, glass scale) read at the same stops.
"""

import csv
import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from drivers.base.named_file import write_text
from drivers.base.text_file import UnsuitableFileError, read_bounded, words_of
from hil.control.laws.base import Array
from hil.rig.schema import RigError

ENCODER: Final = "encoder"
COLUMNS: Final = ("axis", "run", "direction", "target", ENCODER)
REFERENCE: Final = "reference"
DIRECTIONS: Final = ("up", "down")
LARGEST_FILE: Final = 1 << 20  # bytes: 100 targets, 100 runs and four axes are half of it


class Deviations(NamedTuple):
    """Of one axis, from its targets, (targets, runs), m (rad)."""

    targets: list[float]
    up: Array
    down: Array


def write_approaches(path: Path, found: Mapping[str, Deviations]) -> None:
    """By axis. Positions in m (rad). Raises OSError."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(COLUMNS)
    for name, axis in found.items():
        places = range(len(axis.targets))
        for run in range(axis.up.shape[1]):
            for direction, order, deviations in (("up", places, axis.up), ("down", reversed(places), axis.down)):
                for place in order:
                    target = axis.targets[place]
                    encoder = target + float(deviations[place, run])
                    rows.writerow((name, run + 1, direction, repr(target), repr(encoder)))
    write_text(path, text.getvalue())


def read_reference(path: Path, axes: list[str], column: str = REFERENCE) -> dict[str, Deviations]:
    """By axis, from the column `reference` of such a file: m (rad), its zero wherever the instrument has it. Rows may
    stand in any order; every target of an axis needs every run in both directions. column: or ENCODER.

    Raises RigError naming line, column and value.
    """
    rows = _rows(path)
    missing = [name for name in (*COLUMNS[:4], column) if rows and name not in rows[0][1]]
    if missing:
        raise RigError([f"{path}: there is no column {missing[0]}; --out FILE writes {','.join(COLUMNS)}"])
    read: dict[str, dict[tuple[float, str, int], float]] = {}
    for number, row in rows:
        where = f"{path}, line {number}"
        axis, direction = (row["axis"] or "").strip(), (row["direction"] or "").strip()
        if axis not in axes:
            raise RigError([f"{where}: axis = {axis!r}: one of {', '.join(axes)}"])
        if direction not in DIRECTIONS:
            raise RigError([f"{where}: direction = {direction!r}: one of {', '.join(DIRECTIONS)}"])
        key = (_number(where, row, "target"), direction, round(_number(where, row, "run")))
        if key in read.setdefault(axis, {}):
            raise RigError([f"{where}: axis {axis}, target {key[0]:g}, {direction}, run {key[2]} stands there twice"])
        read[axis][key] = _number(where, row, column)
    if not read:
        raise RigError([f"{path}: it has no rows"])
    return {axis: _arranged(path, axis, readings) for axis, readings in read.items()}


def _rows(path: Path) -> list[tuple[int, dict[str, str]]]:
    """Each with the number of its line."""
    try:
        lines = csv.DictReader(io.StringIO(read_bounded(path, LARGEST_FILE).decode("utf-8-sig"), newline=""))
        return [(lines.line_num, row) for row in lines]
    except OSError as error:
        raise RigError([f"{path}: {words_of(error)}"]) from None
    except (UnicodeDecodeError, UnsuitableFileError, csv.Error) as error:
        raise RigError([f"{path}: {error}"]) from None


def _number(where: str, row: dict[str, str], column: str) -> float:
    try:
        value = float(row[column])
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise RigError([f"{where}: {column} = {row[column]!r} is not a finite number"])
    return value


def _arranged(path: Path, axis: str, readings: dict[tuple[float, str, int], float]) -> Deviations:
    targets, runs = sorted({target for target, _, _ in readings}), sorted({run for _, _, run in readings})
    if len(targets) < 2 or len(runs) < 2:
        raise RigError([f"{path}, axis {axis}: {len(targets)} targets, {len(runs)} runs: 2 or more of each are needed"])
    sides = []
    for direction in DIRECTIONS:
        side = np.empty((len(targets), len(runs)))
        for place, target in enumerate(targets):
            for at, run in enumerate(runs):
                if (target, direction, run) not in readings:
                    raise RigError([f"{path}, axis {axis}: target {target:g}, {direction}, run {run} is missing"])
                side[place, at] = readings[target, direction, run] - target
        sides.append(side)
    return Deviations(targets, *sides)
