"""Rigs to work with in Python: what a rig file says, validated, and the folder its own files are relative to."""

import copy
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.control.laws.base import Law
from hil.rig.file import build_rig, rig_hash
from hil.rig.file import load_rig as read_rig
from hil.rig.schema import RigConfig, RigError
from hil.rig.shipped import by_name
from hil.runs.class_text import ClassTextError, class_text

# key.path=value texts, or keys with their values: {"plant.mass_scale": 1.2}
Overrides = Sequence[str] | Mapping[str, object]
NO_CHANGES: Overrides = ()


@dataclass(frozen=True, repr=False)
class Rig:
    """A validated rig and the folder that the files it names are relative to. Made by `load_rig` or `Rig.build`."""

    config: RigConfig
    folder: Path
    _source: Path | dict[str, Any]
    _overrides: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Rig {self.name}: axes {', '.join(self.axes)}; {self.config.rate_hz:g} Hz; {self.config.law.name}>"

    @classmethod
    def build(cls, document: dict[str, Any], folder: str | os.PathLike[str] = ".") -> "Rig":
        """From a document as the rig file's TOML would give it. Raises RigError."""
        return _rig(document, Path(folder), ())

    def changed(
        self, *overrides: str | Mapping[str, object], law: str | type[Law] | None = None, **keys: object
    ) -> "Rig":
        """The same rig with other values, beyond those it has: "key.path=value" texts, {"key.path": value} mappings, or
        keywords for keys at the top, rate_hz=500. law: a law's name, or your own class. Raises RigError.
        """
        words = [word for one in (*overrides, keys) for word in override_words([one] if isinstance(one, str) else one)]
        if isinstance(law, type):
            of_law = tuple(word for word in words if word.startswith("law."))
            others = [word for word in words if word not in of_law]
            return _rig(_with_law(self.changed(*others).config, law), self.folder, of_law)
        named = [] if law is None else [f"law.name={law}"]
        return _rig(self._source, self.folder, (*self._overrides, *named, *words))

    @property
    def name(self) -> str:
        """The rig's name."""
        return self.config.name

    @property
    def axes(self) -> list[str]:
        """Names of the axes, in the order of every array's last index."""
        return self.config.axis_names

    @property
    def sha256(self) -> str:
        """Of everything the rig says, the texts of its law's and task's files included."""
        return rig_hash(self.config)


def _rig(source: Path | dict[str, Any], folder: Path, overrides: tuple[str, ...]) -> Rig:
    if isinstance(source, Path):
        return Rig(read_rig(source, overrides), folder, source, overrides)
    return Rig(build_rig(copy.deepcopy(source), overrides, folder=folder), folder, copy.deepcopy(source), overrides)


def override_words(overrides: Overrides) -> list[str]:
    """Overrides as key.path=value texts; JSON's numbers, texts, truths and lists are TOML's."""
    if not isinstance(overrides, Mapping):
        return list(overrides)
    try:
        return [f"{key}={json.dumps(_plain(value), allow_nan=False)}" for key, value in overrides.items()]
    except (TypeError, ValueError) as error:
        raise RigError([f"overrides: {error}"]) from None


def _plain(value: Any) -> Any:
    """Numbers and arrays of numpy as Python's."""
    return value.tolist() if hasattr(value, "tolist") else value


def _with_law(rig: RigConfig, law: type[Law]) -> dict[str, Any]:
    """The rig's document with a class as its law, and the text of that class."""
    document = rig.model_dump(mode="json")
    try:
        document["law"] = {"name": f"./{law.__name__.lower()}.py:{law.__name__}", "source": class_text(law)}
    except ClassTextError as error:
        raise RigError([f"law = {law.__name__}: {error}"]) from None
    return document


def load_rig(path: str | os.PathLike[str], overrides: Overrides = NO_CHANGES) -> Rig:
    """Read a rig file, or a shipped one by its name ("paper"); overrides: key.path=value texts, or a mapping.

    Raises RigError naming key, value and what is allowed.
    """
    file = by_name("rigs", Path(path))
    return _rig(file, file.parent, tuple(override_words(overrides)))
