"""A run's columns as a table for people (CSV), as arrays that lose nothing (NPZ), and back."""

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from drivers.base.named_file import naming
from drivers.base.text_file import UnsuitableFileError, open_untrusted, words_of
from drivers.base.toml_file import short
from hil.rig.file import build_rig
from hil.rig.npz_file import read_arrays
from hil.rig.schema import RigConfig, RigError
from hil.runs.columns import Columns
from hil.telemetry.recording import RecordingError

Table = Mapping[str, NDArray[Any]]
_RIG = "rig_json"
_TRUE = "true_position"
_LARGEST = 2**32  # bytes: a day of four axes at 1 kHz, compressed
_FREELY = 2**26  # bytes that the columns may take whatever the size of the file: ten minutes that compress to nothing


def write_csv(path: Path, table: Table) -> None:
    """A header line and a line a tick; numbers with all their digits, NaN as nothing. Raises OSError."""
    rows = zip(*(values.tolist() for values in table.values()), strict=True)
    with naming(path), path.open("w", encoding="utf-8", newline="") as file:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(table)
        lines.writerows([_cell(value) for value in row] for row in rows)


def _cell(value: Any) -> Any:
    return "" if value != value else value  # NaN alone is unlike itself


def write_npz(path: Path, rig: RigConfig, columns: Columns, true: NDArray[np.float64] | None) -> None:
    """All columns with their types and the rig: what `read_npz` takes. Raises OSError."""
    arrays: dict[str, Any] = {**columns} | ({} if true is None else {_TRUE: true})
    arrays[_RIG] = np.frombuffer(json.dumps(rig.model_dump(mode="json")).encode(), dtype=np.uint8)
    with naming(path):
        np.savez_compressed(path, **arrays)


def read_npz(path: Path) -> tuple[RigConfig, Columns, NDArray[np.float64] | None]:
    """The rig, the columns, and the true position where it was known. Raises RecordingError, RigError."""
    try:
        with open_untrusted(path, _LARGEST) as file:
            columns = read_arrays(file, _FREELY)
        document = json.loads(columns.pop(_RIG).tobytes())
        ticks = len(columns["scheduled_ns"])
    except OSError as error:
        raise RecordingError(f"{path}: {words_of(error)}") from None
    except (UnsuitableFileError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise RecordingError(f"{path}: not a run that hil has exported: {short(str(error))}") from None
    if any(values.ndim not in (1, 2) or len(values) != ticks for values in columns.values()):
        raise RecordingError(f"{path}: not a run that hil has exported: columns of other lengths")
    true = columns.pop(_TRUE, None)
    try:
        return build_rig(document, carried=True), cast(Columns, columns), true
    except RigError as error:
        raise error.of_file(path) from None
