"""What the page's Rig and Runs tell: limits and bus load of the running rig, and the runs of a folder."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from drivers.base.toml_file import short
from drivers.protocols.base import LayoutError
from hil.rig.bus_load import analyse_rig, rig_layout
from hil.rig.provenance import rig_of_run
from hil.rig.schema import RigError
from hil.runs.listed import listed_runs

NEWEST: Final = 200  # runs
LONGEST: Final = 500  # characters of a text


def rig_facts(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Of a ring's metadata; {} where no control process has left any."""
    if not metadata:
        return {}
    rig = metadata["rig"]
    facts: dict[str, Any] = {
        "hash": str(metadata.get("rig_hash", "")),
        "version": str(metadata.get("version", "")),
        "realtime": str(metadata.get("realtime", "")),
        "rate": float(rig["rate_hz"]),
        "law": str(rig["law"]["name"]),
        "bus": {key: rig["bus"].get(key) for key in ("interface", "channel", "protocol", "bitrate", "data_bitrate")},
        "axes": [_axis(name, axis) for name, axis in rig["axes"].items()],
        "load": None,
        "problem": "",
    }
    try:
        facts["load"] = _load(dict(metadata))
    except (RigError, LayoutError, ValueError, OSError) as error:
        facts["problem"] = f"the bus load cannot be computed: {error}"
    found: dict[str, Any] = clean(facts)
    return found


def _axis(name: str, axis: Mapping[str, Any]) -> dict[str, Any]:
    limits = axis["limits"]
    wanted = ("position", "speed", "force", "force_rate", "following_error")
    return {"name": name, "kind": axis["kind"], "mass": axis["model"]["mass"], **{key: limits[key] for key in wanted}}


def cell_places(rig: Mapping[str, Any]) -> list[list[float]]:
    """x and y of each cell of a rig that injects cells, m; of another: none."""
    motion = rig.get("motion") or {}
    cells = motion.get("parameters", {}).get("cells", []) if motion.get("name") == "cells" else []
    return [[float(cell[0]), float(cell[1])] for cell in cells]


def _load(metadata: dict[str, Any]) -> dict[str, Any]:
    with rig_of_run(metadata) as (rig, base_dir):
        found = analyse_rig(rig, rig_layout(rig, base_dir))
    frames = [
        {"frame": each.frame, "worst": None if each.worst_ns is None else each.worst_ns * 1e-9, "fits": each.fits}
        for each in found.responses
    ]
    return {"share": found.bus_load, "tick": found.tick_ns * 1e-9, "fits": found.schedulable, "frames": frames}


def runs_in(folder: Path) -> list[dict[str, Any]]:
    """The newest runs of a folder, the newest first; none where there is no such folder."""
    if not folder.is_dir():
        return []
    found = listed_runs(folder, lambda _new: lambda: None)[-NEWEST:]
    rows = []
    for run in reversed(found):
        axis, error, kind = run.worst
        facts = run.facts
        rows.append(
            {
                "run": run.kept.folder.name if run.kept.path == run.kept.folder else run.kept.stem,
                "outcome": facts["outcome"],
                "rig": facts["rig"],
                "law": facts["law"],
                "seconds": facts["seconds"],
                "ended": run.ended,
                "lacks": run.lacks,
                "axis": axis,
                "error": error if axis else None,
                "kind": kind,
                "modified": run.kept.modified_ns * 1e-9,
                "note": " ".join([*(f"[{label}]" for label in run.note.labels), run.note.text]).strip(),
            }
        )
    shown: list[dict[str, Any]] = clean(rows)
    return shown


def clean(value: Any) -> Any:
    """The same with every text fit to be shown: names and notes come from files."""
    if isinstance(value, dict):
        return {key: clean(item) for key, item in value.items()}
    if isinstance(value, list):
        return [clean(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return short(value, LONGEST).replace("\n", " ") if isinstance(value, str) else value
