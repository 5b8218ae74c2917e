"""What a recording says about its run: enough to build the same control cycle again, and to know where it came from."""

import importlib.metadata
import json
import platform
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from drivers.config import LAYOUT_KIND
from hil.rig.control_path import control_path
from hil.rig.file import build_rig, document_hash, rig_hash, without_learnt
from hil.rig.schema import LawConfig, RigConfig, RigError

_ABSENT = "a file that is not in the recording"


def describe_run(
    rig: RigConfig, base_dir: Path, *, realtime: str = "", baseline: dict[str, Any] | None = None
) -> dict[str, Any]:
    """The metadata of a ring: rig, hash, versions, machine, clock.

    realtime: the verdict on what the kernel granted, for people. wall_offset_ns: wall clock minus monotonic clock at
    the start; recordings add it to their times so that other tools show a date. baseline: what its accuracy is held
    against (hil.rig.baseline_file), where there is one. What earlier live runs have learnt of the rig is no part of the
    rig, or each run would be one of another rig: it stands beside it, as `learnt`.
    """
    state = rig.law.learnt_state if rig.law.keeps else []
    if state:
        rig = without_learnt(rig)
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
        **({"learnt": {"hash": document_hash({"state": state}), "state": state}} if state else {}),
        **({"baseline": baseline} if baseline else {}),
    }


def referenced_files(rig: RigConfig, base_dir: Path) -> dict[str, str]:
    """Texts of the files that [bus], [sensors] and [outputs] name, by the name they use: the frame layout's, EDS and
    DBC files, numbers of endpoints.
    """
    bought, signals = getattr(rig.bus, "cia402", None), getattr(rig.bus, "dbc", None)
    names = ([rig.bus.file] if rig.bus.file else []) + (bought.eds if bought else [])
    names += [signals.endpoints] if signals and signals.endpoints else []
    names += [sensor.file for sensor in rig.sensors.values() if sensor.file]
    names += [output.file for output in rig.outputs.values() if output.file]
    return {name: (base_dir / name).read_text(encoding="utf-8", errors="surrogateescape") for name in names}


@contextmanager
def rig_of_run(metadata: dict[str, Any], overrides: tuple[str, ...] = ()) -> Iterator[tuple[RigConfig, Path]]:
    """The rig of a described run (with overrides) and a directory with the files it refers to. Raises RigError.

    No file of this machine is read because the run names it, and no code of the run is run here.
    """
    document = json.loads(json.dumps(metadata["rig"]))
    base_dir = Path(tempfile.mkdtemp(prefix="hil-rig-"))
    try:
        try:
            places = _unpack(metadata.get("files", {}), base_dir)
            _point_to(document.get("bus", {}), places)
            for node in (*document.get("sensors", {}).values(), *document.get("outputs", {}).values()):
                if node.get("file"):
                    node["file"] = places.get(node["file"], _ABSENT)
        except (AttributeError, KeyError, TypeError, ValueError, OSError):
            raise RigError(["the recording's description of the files its rig names is damaged"]) from None
        try:
            rig = build_rig(document, overrides, carried=True)
        except RigError as error:
            raise RigError([*error.problems, *filter(None, [other_version(metadata)])]) from None
        if metadata.get("learnt") and rig.law.name == metadata["rig"]["law"]["name"]:
            rig = _with_learnt(rig, metadata["learnt"])
        yield rig, base_dir
    finally:
        shutil.rmtree(base_dir, ignore_errors=True)  # a process that is confined by now cannot; its parent does


def _with_learnt(rig: RigConfig, learnt: Any) -> RigConfig:
    """The rig that begins with what its recording says that it had learnt. Raises RigError."""
    try:
        if document_hash({"state": learnt["state"]}) != learnt["hash"] or len(learnt["state"]) != len(rig.axes):
            raise ValueError
        known = {**rig.law.model_dump(mode="json"), "learnt": "", "learnt_state": learnt["state"]}
        return rig.model_copy(update={"law": LawConfig.model_validate(known)})
    except (TypeError, KeyError, ValueError):
        raise RigError(["the recording's account of what its law had learnt before is damaged"]) from None


def other_version(metadata: dict[str, Any]) -> str:
    """Which version recorded a run and which this is; empty where both are the same."""
    recorded, ours = metadata.get("version"), importlib.metadata.version("hil")
    return "" if recorded == ours else f"recorded by hil {recorded}; this is hil {ours}"


def _unpack(files: dict[str, str], folder: Path) -> dict[str, str]:
    """Write texts into a folder, numbered, as their names are not ours; where each of them is."""
    places = {}
    for number, (name, text) in enumerate(files.items()):
        places[name] = f"{number}-{Path(name).name}"
        (folder / places[name]).write_text(text, encoding="utf-8", errors="surrogateescape")
    return places


def _point_to(bus: dict[str, Any], places: dict[str, str]) -> None:
    """Let [bus] name the unpacked files; what did not come with them is not looked for elsewhere."""
    layout, colon, name = bus.get("protocol", "").partition(":")
    if colon and LAYOUT_KIND.own(bus["protocol"]):
        bus["protocol"] = f"{layout}:{places.get(name, _ABSENT)}"
    if bus.get("cia402"):
        bus["cia402"]["eds"] = [places.get(name, _ABSENT) for name in bus["cia402"].get("eds", [])]
    if bus.get("dbc") and bus["dbc"].get("endpoints"):
        bus["dbc"]["endpoints"] = places.get(bus["dbc"]["endpoints"], _ABSENT)


@contextmanager
def unpacked_rig(document: str, files: dict[str, str]) -> Iterator[tuple[RigConfig, Path]]:
    """A rig (JSON) that came from elsewhere, and a directory with the files it refers to. Raises RigError."""
    with rig_of_run({"rig": json.loads(document), "files": files}) as found:
        yield found
