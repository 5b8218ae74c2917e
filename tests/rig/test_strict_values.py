"""Rig files are strict: no key of numbers takes a truth value or a text, none of texts a number, none of truth 0 or 1.

Taken is what the schema for editors takes: only there, as in JSON, 3.0 is a whole number.
"""

from typing import Any

import pytest

from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from tests.support.paths import RIGS

WRONG: dict[str, list[Any]] = {
    "number": ["true", '"1"', '"x"'],
    "integer": ["true", '"1"', "1.5"],
    "boolean": ["0", "1", '"yes"', '"true"'],
    "string": ["0", "true", "1.5"],
}


SCHEMA = RigConfig.model_json_schema()  # made once: it takes a tenth of a second


def leaves(schema: dict[str, Any], path: str = "") -> dict[str, set[str]]:
    """Types that the schema gives each key of a whole value, by dotted name; lists and tables of lists apart."""
    found: dict[str, set[str]] = {}
    for name, node in schema["properties"].items():
        here = f"{path}{name}"
        options = node.get("anyOf", [node])
        references = [option["$ref"] for option in options if "$ref" in option]
        if references:
            found |= leaves(SCHEMA["$defs"][references[0].rsplit("/", 1)[1]], here + ".")
        elif all("type" in option for option in options):
            found[here] = {option["type"] for option in options}
    return found


FILLED_IN = ("source", "learnt_on")  # when the rig is loaded, whatever the file says
LEAVES = {
    path: types
    for path, types in leaves(SCHEMA).items()
    if types & WRONG.keys() and path.rsplit(".", 1)[-1] not in FILLED_IN
}


def test_there_are_keys_of_every_type() -> None:
    kinds = set().union(*LEAVES.values())
    assert len(LEAVES) > 80
    assert WRONG.keys() <= kinds


@pytest.mark.parametrize("path", LEAVES)
def test_a_value_of_another_type_is_refused_with_the_key(path: str) -> None:
    types = LEAVES[path]
    allowed = {value for kind in types if kind in WRONG for value in _of(kind)}
    wrong = {value for kind in types if kind in WRONG for value in WRONG[kind]} - allowed
    for value in wrong:
        with pytest.raises(RigError, match=path.rsplit(".", 1)[-1]):
            load_rig(RIGS / "paper.toml", [f"{path}={value}"])


def _of(kind: str) -> list[str]:
    """Values of WRONG that are of a type after all."""
    return {
        "number": ["0", "1", "1.5"],
        "integer": ["0", "1"],
        "boolean": ["true"],
        "string": ['"1"', '"x"', '"yes"', '"true"'],
    }[kind]


@pytest.mark.parametrize("value", ["true", '"5"', "[true, 1.0]", '["1", 1.0]'])
@pytest.mark.parametrize("path", ["axes.x.limits.force", "axes.x.model.mass", "estimator.disturbance_noise"])
def test_nor_is_it_in_the_tables_of_axes_and_lists(path: str, value: str) -> None:
    with pytest.raises(RigError, match=path.rsplit(".", 1)[-1]):
        load_rig(RIGS / "paper.toml", [f"{path}={value}"])


def test_a_whole_number_may_have_a_point() -> None:
    assert load_rig(RIGS / "paper.toml", ["bus.node_id=3.0"]).bus.node_id == 3


@pytest.mark.parametrize("value", ["true", "false", '"1"'])
def test_a_direction_is_a_number(value: str) -> None:
    with pytest.raises(RigError, match=r"axes\.x\.direction"):
        load_rig(RIGS / "paper.toml", [f"axes.x.direction={value}"])
    assert load_rig(RIGS / "paper.toml", ["axes.x.direction=-1"]).axes["x"].direction == -1
