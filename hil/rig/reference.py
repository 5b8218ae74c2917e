"""Every key of the rig file, read from the schema: for the reference page, for editors, and for `hil explain`.

`make docs` writes what the schema says into reference.json, so that a command can tell of a key without loading the
schema and the physics behind it: a tenth of a second for half of one.
"""

import difflib
import json
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

WRITTEN = Path(__file__).with_name("reference.json")
ANY_AXIS = "NAME"  # stands for an axis' name in a key's path
_LONGEST = 40  # characters of a name compared with the known ones
_LIKE = 0.65
_BOUNDS = {
    "minimum": "at least", "exclusiveMinimum": "more than", "maximum": "at most", "exclusiveMaximum": "less than"
}  # fmt: skip
_PLURALS = {"number": "numbers", "whole number": "whole numbers"}
_KINDS = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false"}


class Key(NamedTuple):
    """One key. path: from the top, with NAME for an axis' name. kind: type, in words. allowed: range or choice, "" for
    any. default: TOML, or where the value comes from; "required" where the file has to state it.
    """

    path: str
    kind: str
    unit: str
    allowed: str
    default: str
    description: str


class Table(NamedTuple):
    """A table of the rig file: its path ("" for the file itself), what it is, and its keys."""

    path: str
    description: str
    keys: tuple[Key, ...]


class UnknownKeyError(ValueError):
    """There is no such key; the text names those that come nearest."""


@cache
def tables() -> tuple[Table, ...]:
    """All tables in the schema's order, each after the one it is in."""
    written = json.loads(WRITTEN.read_text(encoding="utf-8"))
    return tuple(Table(path, text, tuple(Key(*key) for key in keys)) for (path, text), *keys in written)


def in_schema() -> tuple[Table, ...]:
    """The same, read from the schema itself."""
    schema = _schema()
    return tuple(_tables(schema, schema["$defs"], ""))


def as_json(found: Sequence[Table]) -> str:
    """The tables as reference.json has them: lists of a table's path and description and of its keys, one a line."""
    rows = [[(table.path, table.description), *table.keys] for table in found]
    lines = [",\n".join(json.dumps(row, ensure_ascii=False) for row in table) for table in rows]
    return "[[\n" + "\n],[\n".join(lines) + "\n]]\n"


def _schema() -> dict[str, Any]:
    from hil.rig.schema import RigConfig  # half a second that `tables` spares

    return RigConfig.model_json_schema()


def json_schema() -> dict[str, Any]:
    """The JSON schema by which editors complete and check rig files; units are part of the descriptions."""
    schema = _schema()
    for table in (schema, *schema["$defs"].values()):
        for name, field in table.get("properties", {}).items():
            field.pop("title", None)
            unit = field.pop("unit", "")
            derived = field.pop("derived", "")
            text = field.get("description", name) + (f", {unit}" if unit not in ("", "1") else "")
            field["description"] = text + (f"; default: {derived}" if derived else "")
            if derived:
                field.pop("default", None)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def explain(path: str) -> tuple[Key | None, Table | None]:
    """The key of that path and, where it names a table, that table; axes may be called by their own names. Raises
    UnknownKeyError.
    """
    wanted = _general(path.strip().strip("[]").split("."))
    key = next((key for table in tables() for key in table.keys if key.path == wanted), None)
    table = next((table for table in tables() if table.path == wanted), None)
    if key is None and table is None:
        raise UnknownKeyError(f"{path}: no such key; {nearest(path.split('.'))}")
    return key, table


def nearest(location: Sequence[str | int]) -> str:
    """Which known key an unknown one may have meant, in words; where none is like it, the keys of its table."""
    parts = [str(part)[:_LONGEST] for part in location if not isinstance(part, int)]
    own = _general(parts[:-1])
    score, best = max((_likeness(parts[-1], own, key.path), key.path) for table in tables() for key in table.keys)
    if score >= _LIKE:
        return f"the nearest is {best}"
    children = [key.path for table in tables() if table.path == own for key in table.keys]
    return f"{own or 'the top level'} has {', '.join(path.rpartition('.')[2] for path in children)}"


def _likeness(name: str, own: str, path: str) -> float:
    """How like a key's name is to this one, 0 to 1; a little more where its table is like this one's."""
    table, _, last = path.rpartition(".")
    return difflib.SequenceMatcher(None, name, last).ratio() + 0.25 * difflib.SequenceMatcher(None, own, table).ratio()


def _general(parts: Sequence[str]) -> str:
    """The path with NAME for the axis' or sensor's name."""
    named = [ANY_AXIS if index == 1 and parts[0] in ("axes", "sensors") else part for index, part in enumerate(parts)]
    return ".".join(named)


def _tables(schema: dict[str, Any], defs: dict[str, Any], path: str) -> Iterator[Table]:
    keys, inner = [], []
    required = schema.get("required", ())
    for name, field in schema["properties"].items():
        own = f"{path}.{name}" if path else name
        table = _table_in(field, defs)
        if table is not None:
            inner.append((table, f"{own}.{ANY_AXIS}" if "patternProperties" in field else own))
        keys.append(_key(own, field, name in required, is_table=table is not None))
    yield Table(path, " ".join(schema.get("description", "").split()), tuple(keys))
    for table, own in inner:
        yield from _tables(table, defs, own)


def _table_in(field: dict[str, Any], defs: dict[str, Any]) -> dict[str, Any] | None:
    """The table that a field is, has a list of, or has one for each axis of; None for a plain value."""
    for part in (field, *field.get("anyOf", ()), field.get("items", {}), *field.get("patternProperties", {}).values()):
        if "$ref" in part:
            table: dict[str, Any] = defs[part["$ref"].rpartition("/")[2]]
            return table
    return None


def _key(path: str, field: dict[str, Any], required: bool, is_table: bool) -> Key:
    default = "required" if required else field.get("derived") or ("" if is_table else _toml(field.get("default")))
    kind = ("list of tables" if field.get("type") == "array" else "table") if is_table else _kind(field)
    return Key(path, kind, field.get("unit", ""), _allowed(field), default, field.get("description", ""))


def _kind(field: dict[str, Any]) -> str:
    choices = [choice for choice in field.get("anyOf", ()) if choice.get("type") != "null"]
    if choices:
        return " or ".join(_kind(choice) for choice in choices)
    if field.get("type") == "array":
        one = _kind(field["items"])
        return f"list of {one.replace('list', 'lists', 1) if one.startswith('list') else _PLURALS.get(one, one)}"
    return _KINDS.get(field.get("type", ""), "table")


def _allowed(field: dict[str, Any]) -> str:
    for part in (field, *field.get("anyOf", ()), field.get("items", {})):
        if text := _bounds(part):
            return text
    return ""


def _bounds(field: dict[str, Any]) -> str:
    if "enum" in field:
        return ", ".join(_toml(value) for value in field["enum"])
    if "pattern" in field:
        return f"`{field['pattern']}`"
    if "minItems" in field:
        return f"{field['minItems']} values"
    if "minimum" in field and "maximum" in field:
        return f"{field['minimum']:.10g} to {field['maximum']:.10g}"
    return ", ".join(f"{words} {field[name]:.10g}" for name, words in _BOUNDS.items() if name in field)


def _toml(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list):
        return f"[{', '.join(_toml(item) for item in value)}]"
    return "{}" if isinstance(value, dict) else f"{value!r}"
