"""Rig files: validators of JSON schemas by others against the program, on shipped files and on broken ones.

The schema may accept what the program refuses, where two keys have to fit; never the other way round.
"""

import copy
import random
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hil.rig.file import load_rig
from hil.rig.reference import json_schema
from hil.rig.schema import RigConfig, RigError
from tests.peers.sources import UnavailableError, tool
from tests.peers.table import DIFFERS, NOT_RUN, PASSED, Row
from tests.support.paths import RIGS

INSTEAD: tuple[Any, ...] = (
    None,
    True,
    "word",
    -1,
    0,
    1e300,
    float("nan"),
    [],
    {},
    [1, "a"],
    2**70,
)  # of each value, one after another
_SHOWN = 3


def rows(most: int) -> Iterator[Row]:
    """Rows a validator and rig file: as it is, and with at most so many of its values replaced, one at a time."""
    try:
        fastjsonschema, jsonschema = tool("fastjsonschema"), tool("jsonschema")
    except UnavailableError as error:
        yield Row("JSON schema", "rig files", NOT_RUN, str(error))
        return
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    compiled = fastjsonschema.compile(schema)
    validator = jsonschema.Draft202012Validator(schema)
    by_peer: dict[str, Callable[[Any], bool]] = {
        "jsonschema": validator.is_valid,
        "fastjsonschema": lambda facts: _accepts(compiled, facts, fastjsonschema.JsonSchemaException),
    }
    for path in sorted(RIGS.glob("*.toml")):
        facts = tomllib.loads(path.read_text())
        for peer, accepts in by_peer.items():
            yield Row(peer, path.name, PASSED if accepts(facts) and _shipped(path) else DIFFERS)
            yield _broken(peer, path, facts, accepts, most)


def _accepts(check: Callable[[Any], object], facts: Any, refusal: type[Exception]) -> bool:
    try:
        check(facts)
    except refusal:
        return False
    return True


def _shipped(path: Path) -> bool:
    try:
        load_rig(path)
    except RigError:
        return False
    return True


def _ours(facts: dict[str, Any], folder: Path) -> bool:
    try:
        RigConfig.model_validate(facts, context={"folder": folder})
    except (ValidationError, RigError, ValueError):
        return False
    return True


def _broken(peer: str, path: Path, facts: dict[str, Any], accepts: Callable[[Any], bool], most: int) -> Row:
    changes = [(place, value) for place in _places(facts) for value in INSTEAD]
    tried = random.Random(path.name).sample(changes, min(most, len(changes)))
    wrong = []
    for place, value in tried:
        changed = copy.deepcopy(facts)
        _set(changed, place, value)
        if not accepts(changed) and _ours(changed, path.parent):
            wrong.append(f"{'.'.join(map(str, place))} = {value!r}")
    told = (
        f"{len(tried)} changes"
        if not wrong
        else f"only the program accepts {'; '.join(wrong[:_SHOWN])}, {len(wrong)} in all"
    )
    return Row(peer, f"{path.name}: changed", DIFFERS if wrong else PASSED, told)


def _places(facts: Any, above: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    items = facts.items() if isinstance(facts, dict) else enumerate(facts) if isinstance(facts, list) else ()
    for key, value in items:
        yield (*above, key)
        yield from _places(value, (*above, key))


def _set(facts: Any, place: tuple[str | int, ...], value: Any) -> None:
    for key in place[:-1]:
        facts = facts[key]
    facts[place[-1]] = value
