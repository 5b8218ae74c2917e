"""What the reference page, editors and `hil explain` say of a key is what the schema declares, and it is complete."""

import json
import tomllib
from collections.abc import Iterator
from typing import Any

import pytest

from hil.rig.file import load_rig
from hil.rig.reference import Key, UnknownKeyError, explain, json_schema, nearest, tables
from hil.rig.schema import RigError
from tests.support.paths import RIGS

KEYS = {key.path: key for table in tables() for key in table.keys}


@pytest.mark.parametrize("path", KEYS)
def test_every_key_says_what_it_means_in_which_unit(path: str) -> None:
    key = KEYS[path]
    assert key.description
    assert key.kind in ("table", "list of tables") or key.default
    if "number" in key.kind:
        assert key.unit, "dimensionless numbers have the unit 1"


def test_a_key_is_explained_under_the_axis_own_name() -> None:
    key, table = explain("axes.x.limits.speed")
    assert key == Key("axes.NAME.limits.speed", "number", "m/s (rad/s)", "1e-15 to 1e+15", "required", "greatest speed")
    assert table is None
    assert explain("[drives]")[1] == next(table for table in tables() if table.path == "drives")
    assert explain("plant.encoder_resolution")[0].default == "axes.NAME.encoder_resolution"  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("override", "nearest"),
    [
        ("law.nme='pid'", "the nearest is law.name"),
        ("axes.x.limits.sped=1", "the nearest is axes.NAME.limits.speed"),
        ("plant.masses=[1.0, 1.0]", "the nearest is plant.mass"),
        ("watchdog_s=0.1", "the nearest is drives.watchdog_s"),
        ("wire.qqqq=1", "wire has drop_probability, jitter, stuffing, seed"),
        ("zzzz=1", "the top level has name, description, rate_hz"),
        ("bus." + "x" * 200_000 + "=1", "bus has interface"),
    ],
)
def test_an_unknown_key_is_refused_with_the_nearest_known_one(override: str, nearest: str) -> None:
    with pytest.raises(RigError, match="no such key") as caught:
        load_rig(RIGS / "paper.toml", [override])
    assert nearest in str(caught.value)
    assert len(str(caught.value)) < 1000
    with pytest.raises(UnknownKeyError, match="no such key"):
        explain(override.partition("=")[0])


@pytest.mark.parametrize("name", ["paper", "paper-dbc", "microscope-ideal"])
def test_the_shipped_rigs_name_the_schema_for_editors_and_every_key_of_theirs_is_in_it(name: str) -> None:
    text = (RIGS / f"{name}.toml").read_text()
    first, _, rest = text.partition("\n")
    schema = json.loads((RIGS / first.removeprefix("#:schema ")).read_text())
    assert schema["required"] == ["name", "axes"]
    assert schema["additionalProperties"] is False
    for path in leaves(tomllib.loads(rest)):
        explain(".".join(path))


def leaves(document: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Paths of all keys of a rig document, without gains, which each law names as it likes."""
    if path[:1] == ("law",) and len(path) > 1:
        yield path[:2]
    elif isinstance(document, dict):
        for name, value in document.items():
            yield from leaves(value, (*path, name))
    elif isinstance(document, list) and document and isinstance(document[0], dict):
        for value in document:
            yield from leaves(value, path)
    else:
        yield path


def test_the_schema_for_editors_gives_meaning_unit_and_range() -> None:
    axis = json_schema()["$defs"]["LimitsConfig"]["properties"]
    assert axis["speed"]["description"] == "greatest speed, m/s (rad/s)"
    assert (axis["speed"]["minimum"], axis["speed"]["maximum"]) == (1e-15, 1e15)
    assert "default: axes.NAME.model.mass" in json_schema()["$defs"]["PlantConfig"]["properties"]["mass"]["description"]


def test_a_key_in_a_table_of_a_wrong_name_is_sought_in_tables_that_are_like_it() -> None:
    assert nearest(["axes", "x", "limit", "speed"]) == "the nearest is axes.NAME.limits.speed"
