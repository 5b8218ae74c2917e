"""`hil explain KEY`: meaning, type, unit, range and default of a key or table of the rig file."""

from typing import Annotated

import typer

from hil.rig.reference import ANY_AXIS, Key, Table, UnknownKeyError, tables
from hil.rig.reference import explain as look_up


def _completions(incomplete: str) -> list[str]:
    """Keys and tables that begin like this; axes by the name they are given here."""
    axis = incomplete.split(".")[1] if incomplete.startswith("axes.") and incomplete.count(".") > 1 else ANY_AXIS
    known = {name for table in tables() for name in (table.path, *(key.path for key in table.keys))}
    named = [name.replace(f"axes.{ANY_AXIS}", f"axes.{axis}") for name in known]
    return sorted(name for name in named if name.startswith(incomplete))


def explain(
    path: Annotated[
        str,
        typer.Argument(
            metavar="[KEY]", help="for example axes.x.limits.speed, or a table: safety", autocompletion=_completions
        ),
    ] = "",
) -> None:
    """What a key of the rig file means. A table lists its keys; without an argument: the tables."""
    if not path:
        for table in tables():
            print(f"{table.path or 'the file itself':20}  {table.description.partition(']: ')[2] or table.description}")
        return
    try:
        key, found = look_up(path)
    except UnknownKeyError as error:
        raise typer.BadParameter(str(error)) from None
    if key:
        print(_described(key))
    if found:
        print(_listed(found))


def _described(key: Key) -> str:
    rows = {"type": key.kind, "unit": key.unit, "allowed": key.allowed, "default": key.default}
    return "\n".join([f"{key.path}: {key.description}", *(f"  {name:8} {text}" for name, text in rows.items() if text)])


def _listed(table: Table) -> str:
    names = [key.path.rpartition(".")[2] for key in table.keys]
    width = max(map(len, names))
    rows = [f"  {name:{width}}  {key.description}" for name, key in zip(names, table.keys, strict=True)]
    return "\n".join([table.description, *rows])
