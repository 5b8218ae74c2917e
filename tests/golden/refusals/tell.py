"""What a rig file says to any value of any key: it is taken, as another value perhaps, or refused in words.

Every key of the schema gets every one of VALUES, as `--set` does, in two rigs. One story is one table of the rig file.
"""

import json
import re
import tomllib
from functools import cache
from typing import Any

from hil.rig.file import load_rig
from hil.rig.reference import ANY_AXIS, tables
from hil.rig.schema import RigError
from tests.golden.golden import sha256
from tests.support.paths import RIGS, ROOT

RIG_NAMES = ("paper", "microscope")
VALUES = ("0", "1", "-1", "2.5", "1e-9", "1e7", "nan", '"x"', "[]", "[0.5, 0.25]", "[2.0, -1.0, 3.0, 1.0]", "{}")
LONGEST = 160  # characters of an outcome; a longer one ends with its hash


@cache
def keys() -> dict[str, list[str]]:
    """The keys of every table, of the axis x and of the whole rig."""
    named = [(table.path.replace(ANY_AXIS, "x") or "rig", table.keys) for table in tables()]
    return {name: sorted(key.path.replace(ANY_AXIS, "x") for key in held) for name, held in named}


def stories() -> list[str]:
    """Their names."""
    return list(keys())


def outcome(rig: str, key: str, value: str) -> str:
    """What comes of one of them: the value that is taken, or the refusal."""
    try:
        found: Any = load_rig(RIGS / f"{rig}.toml", [f"{key}={value}"]).model_dump(mode="json")
    except RigError as error:
        return f"refused: {error}".replace(f"{RIGS}/{rig}.toml: ", "").replace(str(ROOT), "")
    for part in key.split("."):
        found = found.get(part) if isinstance(found, dict) else None
    if isinstance(found, dict) or (not isinstance(found, bool) and found == tomllib.loads(f"value = {value}")["value"]):
        return "taken"  # of a table, the keys have lines of their own
    return f"taken as {json.dumps(found)}"


def tell(story: str) -> list[str]:
    """Of a table, key by key: values with the same outcome share a line."""
    return [line for key in keys()[story] for line in lines(key, *(outcomes(key, rig) for rig in RIG_NAMES))]


def outcomes(key: str, rig: str) -> list[str]:
    """Of every value."""
    return [outcome(rig, key, value) for value in VALUES]


def lines(key: str, told: list[str], elsewhere: list[str]) -> list[str]:
    """Of one key: in the first rig, and of the second what is told otherwise there."""
    shared: dict[str, list[str]] = {}
    for value, one, other in zip(VALUES, told, elsewhere, strict=True):
        first, second = (_short(re.sub(rf"{re.escape(key)} = [^:]*: ", f"{key}: ", text)) for text in (one, other))
        shared.setdefault(first, []).append(value)
        if second != first:
            shared.setdefault(f"in {RIG_NAMES[1]} {second}", []).append(value)
    return [key, *(f"    {'  '.join(values)}  ->  {text}" for text, values in shared.items())]


def _short(text: str) -> str:
    one_line = " | ".join(text.splitlines())
    return one_line if len(one_line) <= LONGEST else f"{one_line[:LONGEST]}... sha256 {sha256(one_line, digits=8)}"
