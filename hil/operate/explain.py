"""`hil explain KEY`: meaning, type, unit, range and default of a key or table of the rig file."""

from typing import Annotated

import typer

from hil.rig.key_text import key_text
from hil.rig.reference import ANY_AXIS, UnknownKeyError, tables


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
    try:
        print(key_text(path))
    except UnknownKeyError as error:
        raise typer.BadParameter(str(error)) from None
