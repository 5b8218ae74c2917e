"""Designs of the rig's filter, kept from one process to the next: filterpy's imports take a second of every start.

A control process that begins again after a crash should be back as soon as it can.

What is kept is a function of what is asked, of the code that designs and of the packages under it; anything else found
is ignored, and so is a directory that anybody else could have written to. Nothing here may stop a process.
"""

import contextlib
import hashlib
import json
import os
import stat
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from drivers.runtime import write_private

MOST_KEPT = 200
# ImportError: a package without its metadata. LookupError, TypeError: kept by another version, in another form.
_NOT_TO_BE_HAD = (OSError, ValueError, ImportError, LookupError, TypeError)


def recall(parameters: str) -> Any | None:
    """The design kept for these parameters (JSON); None where there is none that can be trusted."""
    with contextlib.suppress(*_NOT_TO_BE_HAD):
        directory, asked = _directory(), _asked(parameters)
        if _is_ours(directory):
            digest, _, text = _file(directory, asked).read_text(encoding="ascii").partition("\n")
            if digest == _digest(text):
                kept = json.loads(text)
                return kept["design"] if kept["asked"] == asked else None
    return None


def keep(parameters: str, design: Any) -> None:
    """Keep a design, where there is room and a directory of our own; the oldest go beyond MOST_KEPT."""
    with contextlib.suppress(*_NOT_TO_BE_HAD):
        directory, asked = _directory(), _asked(parameters)
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _is_ours(directory):
            return
        text = json.dumps({"asked": asked, "design": design})
        write_private(_file(directory, asked), f"{_digest(text)}\n{text}")
        by_age = sorted(directory.iterdir(), key=lambda path: path.stat().st_mtime_ns)
        for old in by_age[:-MOST_KEPT]:
            old.unlink(missing_ok=True)


def _directory() -> Path:
    """$CACHE_DIRECTORY (set by systemd), $XDG_CACHE_HOME/hil or ~/.cache/hil; of designs, in it."""
    service = os.environ.get("CACHE_DIRECTORY", "").partition(":")[0]
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return (Path(service) if service else Path(base) / "hil") / "designs"


def _is_ours(directory: Path) -> bool:
    found = directory.lstat()
    others_may_write = found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid() and not others_may_write


def _file(directory: Path, asked: str) -> Path:
    return directory / f"{_digest(asked)}.json"


def _asked(parameters: str) -> str:
    """The parameters, and everything else that a design depends on."""
    designer = find_spec("hil.control.estimator.filterpy_design")
    code = Path(designer.origin).read_bytes() if designer and designer.origin else b""
    packages = {name: version(name) for name in ("filterpy", "numpy", "scipy")}
    return json.dumps([json.loads(parameters), hashlib.sha256(code).hexdigest(), packages])


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("ascii")).hexdigest()
