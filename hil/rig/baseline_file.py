"""Where the baseline of a rig and task is kept: hil.events.baseline says what it is."""

import hashlib
import json
import math
import os
from pathlib import Path
from typing import Any

from drivers.base.runtime import state_folder, write_private
from drivers.base.text_file import UnsuitableFileError, read_bounded
from hil.rig.schema import RigConfig

FORMAT = 1
_LARGEST = 2**20  # bytes


def baseline_path(rig: RigConfig) -> Path:
    """By the rig's name, and by what makes runs alike: its task, law and rate. Gains and limits may be tuned since."""
    alike = [rig.task.model_dump(mode="json"), rig.law.name, rig.rate_hz, rig.axis_names]
    digest = hashlib.sha256(json.dumps(alike, sort_keys=True).encode()).hexdigest()[:12]
    return state_folder() / "baselines" / f"{rig.name}-{digest}.json"


def write_baseline(rig: RigConfig, document: dict[str, Any]) -> Path:
    """Keep it, in the place of an earlier one. Raises OSError."""
    path = baseline_path(rig)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    write_private(path, json.dumps({"format": FORMAT, **document}, indent=1) + "\n")
    return path


def read_baseline(rig: RigConfig) -> dict[str, Any] | None:
    """The one that is kept; None where there is no usable one."""
    try:
        found = json.loads(read_bounded(baseline_path(rig), _LARGEST))
    except (OSError, UnsuitableFileError, ValueError, RecursionError):
        return None
    return found if is_baseline(found, rig.axis_names) else None


def is_baseline(found: object, axes: list[str]) -> bool:
    """Whether it has the form that later runs are held against; it may come from a recording."""
    try:
        assert isinstance(found, dict)
        steady = all(math.isfinite(value) for value in found["steady"].values()) and isinstance(found["run"], str)
        known = steady and {*found["axes"]} <= {*axes}
        return found["format"] == FORMAT and known and all(map(_phases, found["axes"].values()))
    except (KeyError, TypeError, AttributeError, AssertionError, ValueError):
        return False


def _phases(axis: dict[str, dict[str, Any]]) -> bool:
    pairs = [pair for row in axis.values() for name, pair in row.items() if name not in ("windows", "bands") and pair]
    counted = all(int(row["windows"]) >= 1 for row in axis.values())
    return counted and all(len(pair) == 2 and all(map(math.isfinite, pair)) for pair in pairs)


def forget_baseline(rig: RigConfig) -> bool:
    """Whether there was one. Raises OSError."""
    try:
        os.unlink(baseline_path(rig))
    except FileNotFoundError:
        return False
    return True
