"""What the runs of a folder take on the disk, held against the quota of recordings."""

import contextlib
import os
import re
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from hil.rig.tables import TelemetryConfig
from hil.runs.listed import ListedRun

KINDS = {
    "recordings": re.compile(r"run(-\d+)?(\.part-\d+)?\.mcap"),
    "fault snapshots": re.compile(r"fault-.*\.mcap"),
    "black boxes": re.compile(r"blackbox.*\.mcap"),
    "other files": re.compile(r".*", re.DOTALL),
}


def disk_use(folder: Path, runs: Sequence[ListedRun]) -> dict[str, Any]:
    """By kind {"files", "bytes"}; bytes: of all; quota: bytes, of the newest run whose rig can be read, named in
    quota_of, else hil's own; kept: bytes of recordings, snapshots and black boxes. Raises OSError.
    """
    kinds = {kind: {"files": 0, "bytes": 0} for kind in KINDS}
    for name, size in _files(folder):
        kind = next(kind for kind, pattern in KINDS.items() if pattern.fullmatch(name))
        kinds[kind]["files"] += 1
        kinds[kind]["bytes"] += size
    newest = next((run.facts for run in reversed(runs) if run.facts["quota"]), None)
    return {
        "kinds": kinds,
        "bytes": sum(row["bytes"] for row in kinds.values()),
        "kept": sum(row["bytes"] for kind, row in kinds.items() if kind != "other files"),
        "quota": newest["quota"] if newest else TelemetryConfig().record_quota,
        "quota_of": newest["rig"] if newest else "",
    }


def _files(folder: Path, *, inner: bool = False) -> Iterator[tuple[str, int]]:
    """(name, bytes) of the files in a folder and in the folders in it; links are not followed."""
    with os.scandir(folder) as entries:
        for entry in entries:
            with contextlib.suppress(OSError):  # it went meanwhile, or may not be read
                found = entry.stat(follow_symlinks=False)
                if stat.S_ISREG(found.st_mode):
                    yield entry.name, found.st_size
                elif stat.S_ISDIR(found.st_mode) and not inner:
                    yield from _files(folder / entry.name, inner=True)
