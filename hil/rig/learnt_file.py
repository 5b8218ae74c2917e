"""Files of what a law has learnt over the repeats of a task: JSON with the hash of the rig that it was learnt on.

`hil learnt RUN` writes one from a recording; `law.learnt` names it.
"""

import json
import math
from pathlib import Path
from typing import Any

from drivers.base.named_file import write_text

LARGEST = 2**26  # bytes


class LearntFileError(ValueError):
    """A file that holds nothing learnt; the text says what is wrong with it."""


def write_learnt_file(path: Path, rig_name: str, learnt_on: str, state: dict[str, list[float]]) -> None:
    """state: by axis, as its law gives it. Raises OSError."""
    write_text(path, json.dumps({"rig": rig_name, "rig_hash": learnt_on, "state": state}) + "\n")


def read_learnt_file(path: Path, axes: list[str]) -> tuple[str, list[list[float]]]:
    """The rig's hash, and the state of each of these axes. Raises LearntFileError."""
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST + 1)
        document: Any = json.loads(data) if len(data) <= LARGEST else None
    except OSError as error:
        raise LearntFileError(f"{path}: {error.strerror or error}") from None
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict) or not isinstance(document.get("state"), dict):
        raise LearntFileError(f"{path}: no file of `hil learnt`: JSON with rig_hash and state, at most {LARGEST} bytes")
    found = []
    for axis in axes:
        values = document["state"].get(axis)
        if not isinstance(values, list) or not all(_is_finite(value) for value in values):
            raise LearntFileError(f"{path}: state.{axis}: expected a list of finite numbers")
        found.append([float(value) for value in values])
    if len({len(values) for values in found}) > 1:
        raise LearntFileError(f"{path}: state: axes of different lengths")
    return str(document.get("rig_hash")), found


def _is_finite(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and abs(value) < 1e100 and math.isfinite(value)
