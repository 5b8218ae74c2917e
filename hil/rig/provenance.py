"""What a recording says about its run: enough to build the same control cycle again, and to know where it came from."""

import importlib.metadata
import json
import platform
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from hil.rig.file import build_rig, rig_hash
from hil.rig.schema import RigConfig, RigError


def describe_run(rig: RigConfig, base_dir: Path, *, realtime: str = "") -> dict[str, Any]:
    """The metadata of a ring: rig, hash, versions, machine, clock.

    realtime: the verdict on what the kernel granted, for people. wall_offset_ns: wall clock minus monotonic clock at
    the start; recordings add it to their times so that other tools show a date.
    """
    return {
        "rig": rig.model_dump(mode="json"),
        "rig_hash": rig_hash(rig),
        "files": referenced_files(rig, base_dir),
        "realtime": realtime,
        "wall_offset_ns": time.time_ns() - time.monotonic_ns(),
        "version": importlib.metadata.version("hil"),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "control_path": control_path(),
        "platform": platform.platform(),
    }


def referenced_files(rig: RigConfig, base_dir: Path) -> dict[str, str]:
    """Texts of the files the rig file names, by the name it uses (today: the DBC file of a `dbc:` protocol)."""
    kind, _, name = rig.bus.protocol.partition(":")
    return {name: (base_dir / name).read_text(encoding="utf-8", errors="surrogateescape")} if kind == "dbc" else {}


@contextmanager
def rig_of_run(metadata: dict[str, Any], overrides: tuple[str, ...] = ()) -> Iterator[tuple[RigConfig, Path]]:
    """The rig of a described run (with overrides) and a directory with the files it refers to. Raises RigError."""
    document = json.loads(json.dumps(metadata["rig"]))
    with tempfile.TemporaryDirectory(prefix="hil-rig-") as directory:
        base_dir = Path(directory)
        try:
            for name, text in metadata.get("files", {}).items():
                place = base_dir / Path(name).name
                place.write_text(text, encoding="utf-8", errors="surrogateescape")
                document["bus"]["protocol"] = f"dbc:{place.name}"
        except (AttributeError, KeyError, TypeError, ValueError, OSError):
            raise RigError(["the recording's description of the files its rig names is damaged"]) from None
        yield build_rig(document, overrides), base_dir


@contextmanager
def unpacked_rig(document: str, files: dict[str, str], folder: Path) -> Iterator[tuple[RigConfig, Path]]:
    """A rig (JSON) that came from elsewhere, and a directory with the files it refers to: `folder`, where it needs
    none. Raises RigError.
    """
    if not files:
        yield build_rig(json.loads(document)), folder
        return
    with rig_of_run({"rig": json.loads(document), "files": files}) as found:
        yield found


def control_path() -> str:
    """ "interpreted" or "compiled", by what Python would load as the control cycle itself."""
    found = find_spec("hil.cycle.step")
    origin = found.origin if found else None
    return "interpreted" if origin is None or origin.endswith(".py") else "compiled"
