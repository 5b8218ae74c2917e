"""The batch as a CSV file that grows cell by cell, and from which an interrupted batch goes on.

A row is on the disk before the tip touches its cell, with the verdict `none`, and is written anew once the cell is
over. So whatever ends a batch, the file says which cells may have been pierced.
"""

import contextlib
import csv
import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import fields
from math import nan
from pathlib import Path
from typing import Any, Final, get_type_hints

from drivers.base.text_file import words_of
from hil.control.motion.injection.verdict import CellResult, Phase, Verdict
from hil.rig.schema import RigError
from hil.rig.task_file import TaskFileError, file_bytes
from hil.studies.inject.batch import Follower, Injected
from hil.studies.inject.equipment import Positions

SAME: Final = 1e-9  # m; a place nearer than this is the same
_RESULT: Final = {field.name: get_type_hints(CellResult)[field.name] for field in fields(CellResult)}
_TRUTH: Final = {
    "anomaly": str, "expected": Verdict, "true_peak_force": float, "found_depth": float, "known_after": float,
    "lurch": float, "wrong_pulses": int,
}  # fmt: skip
COLUMNS: Final = (
    "number",
    "verdict",
    "x",
    "y",
    *(name for name in _RESULT if name not in ("number", "verdict")),
    *_TRUTH,
)


def row_of(cell: Injected, places: Positions) -> dict[str, Any]:
    """SI units; numbers count from 1, verdicts are words, and what did not happen is NaN."""
    found: dict[str, Any] = {name: getattr(cell.result, name) for name in _RESULT}
    found["number"] = cell.result.number + 1
    found["verdict"] = cell.result.verdict.name.lower()
    found["x"], found["y"] = places[cell.result.number]
    truth = {name: getattr(cell, "peak_force" if name == "true_peak_force" else name) for name in _TRUTH}
    truth["expected"] = "" if cell.expected is Verdict.NONE else cell.expected.name.lower()
    return {name: {**found, **truth}[name] for name in COLUMNS}


class Sheet(Follower):
    """One CSV file. Raises RigError where it cannot be written."""

    def __init__(self, path: Path, places: Positions, done: Sequence[Injected] = ()) -> None:
        """done: cells that are over, of an earlier part of the batch; the file is written anew with these."""
        self._path, self._places = path, places
        lines = [_line(dict(zip(COLUMNS, COLUMNS, strict=True))), *(_line(row_of(cell, places)) for cell in done)]
        fresh = path.with_name(f"{path.name}.new")
        try:
            with fresh.open("w", encoding="utf-8", newline="") as file:
                file.write("".join(lines))
                file.flush()
                os.fsync(file.fileno())
            fresh.replace(path)
            self._file = path.open("r+b")
        except OSError as error:
            raise RigError([f"{path}: {words_of(error)}"]) from None
        self._end = self._file.seek(0, os.SEEK_END)  # of the rows that are final
        self._begun = 0  # number of the cell that has a row without a verdict

    def at(self, number: int, phase: int, now_s: float) -> None:
        """The tip is about to touch a cell, or has left one that it did not touch."""
        if Phase.TARE <= phase <= Phase.LIFT:
            if number != self._begun:
                self._begun = number
                self._put(Injected(CellResult(number - 1), "", Verdict.NONE, nan), final=False)
        elif self._begun and phase in (Phase.NONE, Phase.PAUSED):
            self._begun = 0
            self._write(b"")

    def over(self, cell: Injected) -> None:
        """It has its verdict."""
        self._begun = 0
        self._put(cell, final=True)

    def _put(self, cell: Injected, *, final: bool) -> None:
        data = _line(row_of(cell, self._places)).encode()
        self._write(data)
        if final:
            self._end += len(data)

    def _write(self, data: bytes) -> None:
        """In place of what follows the rows that are final."""
        try:
            self._file.seek(self._end)
            self._file.truncate()
            self._file.write(data)
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise RigError([f"{self._path}: {words_of(error)}"]) from None

    def close(self) -> None:
        """What is in it stays."""
        with contextlib.suppress(OSError):
            self._file.close()


def _line(row: Mapping[str, Any]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow("" if value != value else value for value in row.values())
    return text.getvalue()


def read_sheet(path: Path, places: Positions) -> list[Injected]:
    """The cells that are over. One that was begun and has no verdict is `unknown`: it may have been pierced. The cell
    of a broken tip is left out: it was not touched. Raises RigError naming file, row and column.
    """
    try:
        text = file_bytes(path).decode("utf-8")
    except (TaskFileError, UnicodeDecodeError) as error:
        raise RigError([str(error) if isinstance(error, TaskFileError) else f"{path}: no CSV file: {error}"]) from None
    whole = text[: text.rfind("\n") + 1]
    try:
        reader = csv.DictReader(io.StringIO(whole, newline=""))
        rows = list(reader)
    except csv.Error as error:
        raise RigError([f"{path}: no CSV file: {error}"]) from None
    if missing := [name for name in COLUMNS if name not in (reader.fieldnames or ())]:
        raise RigError([f"{path}: no column {missing[0]!r}: it is not a file that `hil inject --csv` wrote"])
    found = [_cell(path, number, row, places) for number, row in enumerate(rows, 1)]
    if len(whole) < len(text):  # cut off while it was written: that cell had been begun
        found.append(Injected(CellResult(len(found)), "", Verdict.NONE, nan))
    for cell in found:
        if cell.result.verdict is Verdict.NONE:
            cell.result.verdict, cell.result.left = Verdict.UNKNOWN, True
            cell.result.evidence = "the batch was interrupted in this cell"
    return [cell for cell in found if cell.result.verdict is not Verdict.BROKEN]


def _cell(path: Path, number: int, row: Mapping[str, str], places: Positions) -> Injected:
    values = {}
    for name, kind in {**_RESULT, **_TRUTH}.items():
        try:
            values[name] = _value(row[name], kind)
        except (ValueError, TypeError, KeyError):
            raise RigError([f"{path}: row {number}, column {name}: {str(row[name])[:40]!r} is none"]) from None
    if values["number"] != number or number > len(places):
        raise RigError([f"{path}: row {number} is cell {values['number']}; expected cell {number} of {len(places)}"])
    at = places[number - 1]
    for name, wanted in zip(("x", "y"), at, strict=True):
        try:
            off = abs(float(row[name]) - wanted)
        except (ValueError, TypeError):
            off = nan
        if not off <= SAME:
            raise RigError(
                [f"{path}: row {number}, column {name}: {row[name]}; this batch has that cell at {wanted:g} m"]
            )
    result = CellResult(**{name: values[name] for name in _RESULT})
    result.number = number - 1
    truth = {name: values[name] for name in _TRUTH if name != "true_peak_force"}
    return Injected(result, peak_force=values["true_peak_force"], **truth)


def _value(text: str, kind: type) -> Any:
    if kind is Verdict:
        return Verdict[text.upper()] if text else Verdict.NONE
    if kind is bool:
        return {"True": True, "False": False}[text]
    if kind is float:
        return float(text) if text else nan
    return kind(text)
