"""Files of what a law has learnt: JSON with hashes of what it was learnt on, of the rig's and of each axis'.

`hil learnt RUN` writes one from a recording, `hil identify --write` beside a rig file, and `hil run` at its end;
`law.learnt` names it.
"""

import json
import math
from pathlib import Path
from typing import Any

from drivers.base.named_file import write_text
from drivers.base.text_file import words_of

LARGEST = 2**26  # bytes


class LearntFileError(ValueError):
    """A file that holds nothing learnt; the text says what is wrong with it."""


def learnt_text(
    rig_name: str, learnt_on: str, axes: dict[str, str], state: dict[str, list[float]], begun: str = ""
) -> str:
    """The content of a file. axes: by axis, the hash of what it was learnt on. state: likewise, as its law gives it; an
    axis without values has learnt nothing. begun: hash of the named state that the learning began with; "": of none.
    """
    document = {"rig": rig_name, "rig_hash": learnt_on, "axes": axes, "state": state}
    return json.dumps(document | ({"begun_with": begun} if begun else {})) + "\n"


def write_learnt_file(
    path: Path, rig_name: str, learnt_on: str, axes: dict[str, str], state: dict[str, list[float]]
) -> None:
    """See learnt_text. Raises OSError."""
    write_text(path, learnt_text(rig_name, learnt_on, axes, state))


def read_learnt_file(path: Path, axes: list[str]) -> tuple[str, list[list[float]]]:
    """The rig's hash, and the state of each of these axes; an empty one has learnt nothing. Raises LearntFileError."""
    document = _document(path)
    found = [_state(path, document, axis) for axis in axes]
    if len({len(values) for values in found if values}) > 1:
        raise LearntFileError(f"{path}: state: axes of different lengths")
    return str(document.get("rig_hash")), found


def read_states(path: Path, hashes: dict[str, str]) -> dict[str, list[float]]:
    """State of those of these axes that the file has with this hash. Raises LearntFileError."""
    document = _document(path)
    on = document.get("axes")
    known = on if isinstance(on, dict) else {}
    return {axis: _state(path, document, axis) for axis, own in hashes.items() if known.get(axis) == own}


def begun_with(path: Path) -> str:
    """Hash of the named state that the file's learning began with; "": of none. Raises LearntFileError."""
    return str(_document(path).get("begun_with", ""))


def _document(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST + 1)
        document: Any = json.loads(data) if len(data) <= LARGEST else None
    except OSError as error:
        raise LearntFileError(f"{path}: {words_of(error)}") from None
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict) or not isinstance(document.get("state"), dict):
        raise LearntFileError(f"{path}: no file of `hil learnt`: JSON with rig_hash and state, at most {LARGEST} bytes")
    return document


def _state(path: Path, document: dict[str, Any], axis: str) -> list[float]:
    values = document["state"].get(axis)
    if not isinstance(values, list) or not all(_is_finite(value) for value in values):
        raise LearntFileError(f"{path}: state.{axis}: expected a list of finite numbers")
    return [float(value) for value in values]


def _is_finite(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and abs(value) < 1e100 and math.isfinite(value)
