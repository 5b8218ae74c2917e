"""Public names of `hil`, line by line: what programs of users may rely on. `python -m tests.support.public_names`
writes those of this version to tests/project/names/VERSION.txt; a test holds them against the version before.
"""

import dataclasses
import inspect
import re
import tomllib
from collections.abc import Iterator
from enum import Enum
from typing import Any, get_args

import hil
from tests.support.paths import ROOT

FOLDER = ROOT / "tests" / "project" / "names"
_SET = re.compile(r"\bself\.([a-z]\w*)(?=[^(\n]* = )")  # what a constructor sets
_OURS = ("hil", "drivers", "sim_plant")


def version() -> str:
    """Of the checkout, which the installed package's may be behind."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return str(project["version"])


def public_names() -> list[str]:
    """A line a name, member or literal, with the parameters and defaults of what can be called."""
    return sorted(line for name in hil.__all__ for line in _lines(name, getattr(hil, name)))


def _lines(name: str, found: Any) -> Iterator[str]:
    if words := get_args(found):
        yield from (f"{name} {word!r}" for word in words)
    elif inspect.isclass(found):
        yield f"{name}{_made_with(found)}"
        yield from (f"{name}.{member}" for member in _members(found))
    else:
        yield f"{name}{_signature(found)}"


def _made_with(found: type) -> str:
    return "" if issubclass(found, BaseException | Enum) else _signature(found)


def _members(found: type) -> set[str]:
    members = set(getattr(found, "_fields", ()))
    for base in found.__mro__:
        if base.__module__.partition(".")[0] in _OURS:
            own = {**vars(base), **getattr(base, "__annotations__", {})}
            if "__init__" in vars(base) and _written(base):
                members |= set(_SET.findall(inspect.getsource(vars(base)["__init__"])))
            members |= {key + _of_member(own[key]) for key in own if not key.startswith("_") and key not in members}
    return members


def _written(found: type) -> bool:
    """Whether its constructor stands in a file: that of a NamedTuple or a dataclass does not."""
    return not hasattr(found, "_fields") and not dataclasses.is_dataclass(found)


def _of_member(member: Any) -> str:
    function = member.__func__ if isinstance(member, classmethod | staticmethod) else member
    return _signature(function) if inspect.isfunction(function) else ""


def _signature(function: Any) -> str:
    """Names and defaults; types are the checkers' business (tests/users)."""
    parameters = inspect.signature(function).parameters.values()
    return "(" + ", ".join(str(each.replace(annotation=each.empty)).split(": ")[0] for each in parameters) + ")"


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / f"{version()}.txt").write_text("\n".join(public_names()) + "\n", encoding="utf-8")
