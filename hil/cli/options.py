"""Arguments and options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

from hil.rig.shipped import by_name


def shipped_rig(rig: Path | None) -> Path | None:
    """A rig file's path, where one of the shipped rigs was named instead."""
    return rig if rig is None else by_name("rigs", rig)


def shipped_scenario(scenario: Path | None) -> Path | None:
    """A scenario file's path, where one of the shipped scenarios was named instead."""
    return None if scenario is None else by_name("scenarios", scenario)


RigFile = Annotated[
    Path,
    typer.Argument(
        metavar="RIG",
        callback=shipped_rig,
        show_default=False,
        help="rig file (TOML), or the name of a shipped one, such as microscope",
    ),
]
Scheduler = Annotated[
    str, typer.Option(metavar="ADDRESS", help="of a dask.distributed cluster that does the work, tcp://host:8786")
]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="override a key of the rig file: key.path=value")
]
