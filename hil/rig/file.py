"""Reading a rig file: TOML, `--set` overrides, validation, and the hash that names a rig."""

import hashlib
import json
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from drivers.base.text_file import words_of
from drivers.base.toml_file import TomlError, first_problems, own_words, parse_toml, read_toml, short, shown
from hil.rig.brought import BroughtError, bring
from hil.rig.former_keys import FormerKeyError, FormerKeyWarning, modernise
from hil.rig.layout import demands, host_layout
from hil.rig.reference import nearest
from hil.rig.schema import LawConfig, RigConfig, RigError, TaskConfig

DEEPEST_OVERRIDE = 8  # keys in one another
# Of a table with a `name`: what belongs to the class it names. An override of the name comes first and drops them.
_BELONG = {"law": ("learnt", "gains"), "estimator": ("parameters",)}
# Of [axes.NAME]: what an axis is, and where its position begins.
_STAGE = {"kind", "encoder_resolution", "direction", "gear", "offset", "home", "error_map", "model"}
_LONGEST = 400  # characters of one problem's text


def _describe(error: dict[str, Any]) -> str:
    """A line for one of pydantic's errors."""
    path = ".".join(short(str(part)) for part in error["loc"]) or "rig"
    value = error.get("input")
    given = "" if isinstance(value, dict) else f" = {shown(value)}"
    unknown = error["type"] == "extra_forbidden"
    words = f"no such key; {nearest(error['loc'])}" if unknown else short(own_words(error["msg"]), _LONGEST)
    return f"{path}{given}: {words}"


def parse_override(text: str) -> tuple[list[str], Any]:
    """Split `key.path=value`; the value is TOML, or a bare word taken as a string. Raises RigError."""
    key, separator, raw = text.partition("=")
    path = key.strip().split(".")
    if not separator or not all(path):
        raise RigError([f"--set {shown(text)}: expected key.path=value, for example --set plant.mass_scale=1.2"])
    if len(path) > DEEPEST_OVERRIDE:
        raise RigError([f"--set {short(text)}: at most {DEEPEST_OVERRIDE} keys in one another"])
    try:
        return path, parse_toml(f"v = {raw.strip()}")["v"]
    except TomlError:
        return path, raw.strip()


def _names_a_class(path: list[str]) -> bool:
    return path[1:] == ["name"] and path[0] in _BELONG


def _apply_override(document: dict[str, Any], path: list[str], value: Any) -> None:
    if _names_a_class(path):
        named = document.setdefault(path[0], {})
        if isinstance(named, dict) and named.get("name") != value:
            for key in _BELONG[path[0]]:
                named.pop(key, None)
    table = document
    for part in path[:-1]:
        child = table.setdefault(part, {})
        if not isinstance(child, dict):
            raise RigError([f"--set {short('.'.join(path))}: '{short(part)}' is a value, not a table"])
        table = child
    table[path[-1]] = value


def _exchange_encoder(document: dict[str, Any], resolution: Any) -> None:
    """An override of plant.encoder_resolution alone means another encoder, with another data sheet: [axes] follows. A
    difference between the two is a modelling error, which has to be stated on both sides.
    """
    axes = document.get("axes")
    tables = [axis for axis in axes.values() if isinstance(axis, dict)] if isinstance(axes, dict) else []
    for index, axis in enumerate(tables):
        own = isinstance(resolution, list) and index < len(resolution)
        axis["encoder_resolution"] = resolution[index] if own else resolution


def _check_learnt(rig: RigConfig) -> None:
    """What was learnt on another stage, law or gains would be played as a disturbance of its own."""
    law = rig.law
    if not law.learnt:
        return
    own = learning_hash(rig)
    if law.learnt_on != own:
        raise RigError(
            [
                f"law.learnt = {shown(law.learnt)}: learnt on another rig (hash {short(law.learnt_on[:12])}, this "
                f"one's is {own[:12]}): run this one without it (--set law.learnt=), then `hil learnt` on that run"
            ]
        )


def _check_layout(rig: RigConfig, folder: Path) -> None:
    """A rig that asks for more than its layout can carry. Other faults of a layout are told by who builds it."""
    if demands(rig):
        try:
            host_layout(rig, folder)
        except (ValueError, OSError) as error:
            raise RigError([str(error)]) from None


def _build(
    document: dict[str, Any], overrides: Sequence[str], folder: Path, *, carried: bool = False
) -> tuple[RigConfig, list[str]]:
    """The rig, and what to change in a document of an earlier version, a line for each key. Raises RigError."""
    parsed = sorted((parse_override(text) for text in overrides), key=lambda item: not _names_a_class(item[0]))
    paths = [path for path, _ in parsed]
    for path, value in parsed:
        if path == ["plant", "encoder_resolution"] and not any(_is_axis_encoder(other) for other in paths):
            _exchange_encoder(document, value)
        _apply_override(document, path, value)
    try:
        lines = modernise(document)
        bring(document, folder, paths, carried=carried)
        rig = RigConfig.model_validate(document)
        _check_learnt(rig)
        if not carried:  # which was checked before it ran
            _check_layout(rig, folder)
        return rig, lines
    except (FormerKeyError, BroughtError) as error:
        raise RigError(str(error).splitlines()) from None
    except ValidationError as error:
        raise RigError(first_problems(error.errors(include_url=False), _describe)) from None


def _is_axis_encoder(path: list[str]) -> bool:
    return len(path) == 3 and path[0] == "axes" and path[2] == "encoder_resolution"


def build_rig(
    document: dict[str, Any], overrides: Sequence[str] = (), *, folder: Path = Path(), carried: bool = False
) -> RigConfig:
    """Validate a parsed rig document, of this version or an earlier one, with `key=value` overrides applied. Raises
    RigError with every problem. folder: what files of laws and tasks are relative to. carried: it came from elsewhere,
    whole, as a recording's: no file that it names is read, and no code run.
    """
    return _build(document, overrides, folder, carried=carried)[0]


def load_rig(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> RigConfig:
    """Read and validate a rig file. Raises RigError naming key, value and allowed range of every problem. A key of an
    earlier version is understood; a FormerKeyWarning then says what to write instead.
    """
    try:
        document = read_toml(path)
    except OSError as error:
        raise RigError([f"{path}: {words_of(error)}"]) from None
    except TomlError as error:
        raise RigError([f"{path}: {error}"]) from None
    try:
        rig, lines = _build(document, overrides, Path(path).parent)
    except RigError as error:
        raise error.of_file(path) from None
    for line in lines:
        warnings.warn(f"{path}: {line}", FormerKeyWarning, stacklevel=2)
    return rig


def task_of_file(rig: RigConfig, path: Path, overrides: Sequence[str] = ()) -> TaskConfig:
    """Another task for a rig: of a TOML file the table [task], of a CSV or NPZ file the path. overrides: key=value, of
    [task] alone. Raises RigError naming file, key or row and column.
    """
    toml = path.suffix.lower() == ".toml"
    table = _table_of(path, "task") if toml else {"kind": "path", "file": path.name}
    _only("task", overrides)
    try:
        return build_rig({**rig.model_dump(mode="json"), "task": table}, overrides, folder=path.parent).task
    except RigError as error:
        raise error.of_file(path) from None


def law_of_file(rig: RigConfig, path: Path | None, overrides: Sequence[str] = ()) -> LawConfig:
    """Another law for a rig: the table [law] of a TOML file, or the rig's own. overrides: key=value, of [law] alone.
    Raises RigError naming file or key.
    """
    _only("law", overrides)
    renamed = any(text.partition("=")[0].strip() == "law.name" for text in overrides)
    kept = {"name", "tuned"} if renamed else {"name", "tuned", "gains"}  # gains are those of the law named
    table = _table_of(path, "law") if path else rig.law.model_dump(mode="json", include=kept)
    folder = path.parent if path else Path()
    try:
        return build_rig({**rig.model_dump(mode="json"), "law": table}, overrides, folder=folder).law
    except RigError as error:
        raise (error.of_file(path) if path else error) from None


def _table_of(path: Path, name: str) -> Any:
    """A table of a TOML file. Raises RigError."""
    try:
        table = read_toml(path).get(name)
    except OSError as error:
        raise RigError([f"{path}: {words_of(error)}"]) from None
    except TomlError as error:
        raise RigError([f"{path}: {error}"]) from None
    if table is None:
        raise RigError([f"{path}: there is no table [{name}]"])
    return table


def _only(table: str, overrides: Sequence[str]) -> None:
    """Raises RigError where an override is of another table."""
    if strange := [text for text in overrides if not text.strip().startswith(f"{table}.")]:
        raise RigError([f"--set {shown(strange[0])}: only keys of [{table}] can be chosen here"])


def rig_hash(rig: RigConfig) -> str:
    """SHA-256 of the validated rig in canonical JSON; two files that mean the same rig have the same hash."""
    return document_hash(rig.model_dump(mode="json"))


def without_learnt(rig: RigConfig) -> RigConfig:
    """The rig as if it had learnt nothing yet."""
    law = rig.law.model_copy(update={"learnt": "", "learnt_on": "", "learnt_state": []})
    return rig.model_copy(update={"law": law})


def learning_hash(rig: RigConfig) -> str:
    """SHA-256 of all that what a law learns depends on; with law.iterative_learning of the whole rig and its task."""
    return rig_hash(without_learnt(rig)) if rig.law.iterative_learning else document_hash(learning_hashes(rig))


def learning_hashes(rig: RigConfig) -> dict[str, str]:
    """The same by axis: its stage and force, the law with its gains, the rate."""
    whole = rig_hash(without_learnt(rig)) if rig.law.iterative_learning else ""
    names = rig.axis_names

    def own(value: Any, at: int) -> Any:
        return value[at] if isinstance(value, list) and len(value) == len(names) else value

    gains = rig.law.effective_gains()
    return {
        name: document_hash(
            {
                "axis": axis.model_dump(mode="json", include=_STAGE),
                "force": axis.limits.force,
                "law": rig.law.name,
                "gains": {key: own(value, at) for key, value in gains.items()},
                "rate": rig.rate_hz,
                "rig": whole,
            }
        )
        for at, (name, axis) in enumerate(rig.axes.items())
    }


def document_hash(rig: dict[str, Any]) -> str:
    """The same of a validated rig that has become JSON, whatever keys later versions have added."""
    canonical = json.dumps(rig, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()
