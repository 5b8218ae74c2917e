"""What a rig file brings with it: its plug-ins' texts or digests, the samples of its task, what its law has learnt.

A document that has them already (work sent to another process) keeps them, unless something else was chosen: it needs
no file, and runs no code. Of a carried document (a recording's) the names are its author's: what it lacks stays away.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drivers.base.plugins import DIGEST, Kind, file_of, known, package_digest
from drivers.base.text_file import UnsuitableFileError, read_bounded
from drivers.base.toml_file import shown
from drivers.config import LAYOUT_KIND
from drivers.sensors.config import sensor_kind
from hil.rig import law_names
from hil.rig.camera import DETECTOR_KIND
from hil.rig.motion_tables import MOTION_KIND
from hil.rig.schema import RigConfig
from hil.rig.tables import ESTIMATOR_KIND
from hil.rig.task_file import TaskFileError, read_task_file
from hil.rig.task_kinds import KIND, is_users, run_task
from sim_plant.config import STAGE_KIND

LARGEST_PLUGIN = 2**20  # bytes of a Python file
PLUGINS = (law_names.KIND, ESTIMATOR_KIND, KIND, MOTION_KIND, STAGE_KIND, LAYOUT_KIND, DETECTOR_KIND)
_OF_A_TASK = ("kind", "parameters", "axes")  # what a user's task is made from


class BroughtError(ValueError):
    """A file or a program that the rig names and that is of no use; a line for each problem."""


def bring(document: dict[str, Any], folder: Path, overridden: Sequence[Sequence[str]], *, carried: bool) -> None:
    """Fill in what the files beside the rig say. overridden: paths of the keys that were chosen after the file.
    carried: the document came from elsewhere; only for what was chosen after it a file is read, or code run.

    Raises BroughtError.
    """
    for plugin, path, table in _tables(document):
        chosen = [*path, plugin.key] in overridden
        if chosen or not carried:
            _read_source(table, plugin, folder, chosen=chosen)
    chosen = ["law", "learnt"] in overridden
    if chosen or not carried:
        _read_learnt(document, folder, chosen=chosen)
    task = document.get("task")
    if not isinstance(task, dict):
        return
    kind, changed = task.get("kind", ""), {path[1] for path in overridden if path[0] == "task" and len(path) > 1}
    lacking = not task.get("samples") and not carried
    if isinstance(kind, str) and kind and is_users(kind):
        anew = "kind" in changed if carried else changed & {*_OF_A_TASK}
        if (anew or lacking) and known(KIND, kind):
            _run_task(task, kind)
    elif isinstance(task.get("file", ""), str) and task.get("file") and ("file" in changed or lacking):
        try:
            file = place_of(task["file"], folder, chosen="file" in changed)
            task["axes"], task["samples"] = read_task_file(file)
        except TaskFileError as error:
            raise BroughtError("\n".join(f"task.file: {line}" for line in str(error).splitlines())) from None


def place_of(name: str, folder: Path, *, chosen: bool) -> Path:
    """Where a file is that a rig names: beside the rig file. One that was chosen after it (`--set`) is where the user
    stands; earlier versions looked beside the rig file for that, too, and a file there still serves.
    """
    here, beside = Path(name), folder / name
    return here if chosen and (here.exists() or not beside.exists()) else beside


def named_files(rig: RigConfig) -> dict[str, str]:
    """The files that a rig names, by key: their paths, as the rig has them."""
    named = {plugin.path: file_of(getattr(getattr(rig, plugin.table), plugin.key, "")) for plugin in PLUGINS}
    for name, sensor in rig.sensors.items():
        named[f"sensors.{name}.kind"], named[f"sensors.{name}.file"] = file_of(sensor.kind), sensor.file
    named |= {f"outputs.{name}.file": output.file for name, output in rig.outputs.items()}
    named["bus.protocol"] = rig.bus.file or named["bus.protocol"]
    named["task.file"] = rig.task.file
    named["law.learnt"] = rig.law.learnt
    return {key: name for key, name in named.items() if name}


def code_of(document: dict[str, Any]) -> list[str]:
    """The plug-ins whose code a rig's document holds or pins, as `law.name = './my_law.py:MyLaw'`."""
    found = [(f"{'.'.join(path)}.{plugin.key}", table) for plugin, path, table in _tables(document)]
    return [f"{key} = {shown(table[key.rpartition('.')[2]])}" for key, table in found if table.get("source")]


def _tables(document: dict[str, Any]) -> list[tuple[Kind, list[str], dict[str, Any]]]:
    """The tables that name a plug-in, each with its kind and its path in the document."""
    found = [(plugin, [plugin.table], document.get(plugin.table)) for plugin in PLUGINS]
    sensors = document.get("sensors")
    if isinstance(sensors, dict):
        for name, table in sensors.items():
            found.append((sensor_kind(name), ["sensors", name], table))
    return [(plugin, path, table) for plugin, path, table in found if isinstance(table, dict)]


def _read_source(table: dict[str, Any], plugin: Kind, folder: Path, *, chosen: bool) -> None:
    """Put the text of a plug-in's file, or the digest of its package, into `source` of its table: part of the rig."""
    name, source = table.get(plugin.key), table.pop("source", "")
    if not isinstance(name, str) or not name or plugin.own(name):
        return
    file = file_of(name)
    place = place_of(file, folder, chosen=chosen)
    try:
        if chosen or not source or str(source).startswith(DIGEST) == bool(file):
            source = _text_of(place) if file else package_digest(plugin, name)
    except (OSError, UnicodeDecodeError, UnsuitableFileError) as error:
        no_text = isinstance(error, UnicodeDecodeError)
        text = "no UTF-8 text" if no_text else getattr(error, "strerror", None) or error
        where = place if file else getattr(error, "filename", "")
        raise BroughtError(f"{plugin.path} = {shown(name)}: {where}: {text}") from None
    if source:
        table["source"] = source


def _text_of(path: Path) -> str:
    return read_bounded(path, LARGEST_PLUGIN).decode().replace("\r\n", "\n")


def _read_learnt(document: dict[str, Any], folder: Path, *, chosen: bool) -> None:
    """Put what law.learnt holds into law.learnt_on and law.learnt_state."""
    law, axes = document.get("law"), document.get("axes")
    if not isinstance(law, dict) or not isinstance(axes, dict) or not isinstance(law.get("learnt", ""), str):
        return
    if not law.get("learnt"):
        for key in ("learnt_on", "learnt_state"):
            law.pop(key, None)
    elif chosen or not law.get("learnt_state"):
        from hil.rig.learnt_file import LearntFileError, read_learnt_file  # few rigs have one

        try:
            law["learnt_on"], law["learnt_state"] = read_learnt_file(
                place_of(law["learnt"], folder, chosen=chosen), list(axes)
            )
        except LearntFileError as error:
            raise BroughtError(f"law.learnt: {error}") from None


def _run_task(task: dict[str, Any], kind: str) -> None:
    """Put what a user's task returns into task.samples."""
    axes, parameters = task.get("axes", []), task.get("parameters", {})
    if not isinstance(parameters, dict) or not isinstance(axes, list) or not all(isinstance(a, str) for a in axes):
        return  # which the schema refuses
    if not axes:
        raise BroughtError(f"task.axes = []: {kind} needs the names of the axes it moves")
    try:
        task["samples"] = run_task(kind, str(task.get("source", "")), axes, parameters)
    except ValueError as error:
        raise BroughtError(str(error)) from error
