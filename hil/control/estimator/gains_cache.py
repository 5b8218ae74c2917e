"""A cache on disk of the rig filter's designed gains, shared by processes.

Importing filterpy takes about a second, and a control process that restarts after a crash should be back as soon as it
can. An entry is keyed by everything a design depends on: the parameters, the code that designs, and the versions of the
packages it uses. An entry that is damaged or has another key is ignored, and so is a directory that anybody else could
have written to. No failure here may stop a process: it costs time only.
"""

import contextlib
import hashlib
import json
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from drivers.base.runtime import cache_folder, is_private, write_private

MAX_ENTRIES = 200
# ImportError: a package without its metadata. LookupError, TypeError: cached by another version, in another form.
_CACHE_ERRORS = (OSError, ValueError, ImportError, LookupError, TypeError)


def load(parameters: str) -> Any | None:
    """The cached design for these parameters (JSON); None where no valid entry exists."""
    with contextlib.suppress(*_CACHE_ERRORS):
        directory, key = _directory(), _key(parameters)
        if is_private(directory):
            digest, _, text = _entry_path(directory, key).read_text(encoding="ascii").partition("\n")
            if digest == _digest(text):
                entry = json.loads(text)
                return entry.get("design") if entry.get("asked") == key else None
    return None


def store(parameters: str, design: Any) -> None:
    """Store a design where there is room and a private directory; delete the oldest beyond MAX_ENTRIES."""
    with contextlib.suppress(*_CACHE_ERRORS):
        directory, key = _directory(), _key(parameters)
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not is_private(directory):
            return
        text = json.dumps({"asked": key, "design": design})  # as earlier versions read it, too
        write_private(_entry_path(directory, key), f"{_digest(text)}\n{text}")
        by_age = sorted(directory.iterdir(), key=lambda path: path.stat().st_mtime_ns)
        for old in by_age[:-MAX_ENTRIES]:
            old.unlink(missing_ok=True)


def _directory() -> Path:
    """The folder of designs."""
    return cache_folder() / "designs"


def _entry_path(directory: Path, key: str) -> Path:
    return directory / f"{_digest(key)}.json"


def _key(parameters: str) -> str:
    """The parameters, and everything else that a design depends on, as canonical text."""
    designer = find_spec("hil.control.estimator.filterpy_design")
    code = Path(designer.origin).read_bytes() if designer and designer.origin else b""
    packages = {name: version(name) for name in ("filterpy", "numpy", "scipy")}
    return json.dumps([json.loads(parameters), hashlib.sha256(code).hexdigest(), packages])


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("ascii")).hexdigest()
