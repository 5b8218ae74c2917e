"""Arguments and options that several commands share."""

import difflib
import errno
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.commands import load
from hil.cli.output import writable
from hil.rig.shipped import by_name, names

_RUNNING = "hil.operate.running_rig:running_rig_file"  # a room above this one


def shipped_rig(rig: Path | None) -> Path | None:
    """A rig file's path, where one of the shipped rigs was named instead. Raises FileNotFoundError for a bare name that
    is neither, with the nearest shipped name.
    """
    return rig if rig is None else _found("rigs", rig)


def any_rig(context: typer.Context, rig: Path | None) -> Path | None:
    """As shipped_rig; for a bare name that is neither, the running rig of that name, as a file that lasts as long as
    the command.
    """
    if rig is not None and len(rig.parts) == 1 and not by_name("rigs", rig).exists():
        running: Path | None = context.with_resource(load(_RUNNING)(str(rig)))
        rig = running or rig
    return shipped_rig(rig)


def shipped_scenario(scenario: Path | None) -> Path | None:
    """A scenario file's path, where one of the shipped scenarios was named instead; errors as for a rig."""
    return None if scenario is None else _found("scenarios", scenario)


def with_law(overrides: Sequence[str] | None, law: str) -> list[str]:
    """The overrides, and that of --law, if it names one."""
    return [*(overrides or ()), *([f"law.name={law}"] if law else [])]


def named_axes(text: str, axes: Sequence[str]) -> list[str]:
    """The axes that --axes names, comma-separated; all where it names none. Raises typer.BadParameter."""
    wanted = [name.strip() for name in text.split(",") if name.strip()] or list(axes)
    if unknown := [name for name in wanted if name not in axes]:
        raise typer.BadParameter(f"--axes {unknown[0]}: the axes are {', '.join(axes)}")
    return wanted


def _found(kind: str, path: Path) -> Path:
    found = by_name(kind, path)
    if len(found.parts) == 1 and not found.exists():
        near = difflib.get_close_matches(found.stem, names(kind), n=1)
        hint = f"did you mean {near[0]}?" if near else f"hil comes with {', '.join(names(kind))}"
        raise FileNotFoundError(errno.ENOENT, f"no such file; {hint}", str(path))
    return found


RigFile = Annotated[
    Path,
    typer.Argument(
        metavar="RIG",
        callback=shipped_rig,
        show_default=False,
        help="rig file (TOML), or the name of a shipped one, such as microscope",
    ),
]
ReadRig = Annotated[
    Path,
    typer.Argument(
        metavar="RIG",
        callback=any_rig,
        show_default=False,
        help="rig file (TOML), the name of a shipped one, such as microscope, or of a running one",
    ),
]
Scheduler = Annotated[
    str, typer.Option(metavar="ADDRESS", help="run on the dask.distributed cluster there, tcp://host:8786")
]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="override a key of the rig file: key.path=value")
]
LawOfRun = Annotated[
    str,
    typer.Option(
        "--law",
        metavar="NAME",
        help="control law: a name, ./file.py:Class or package.module:Class [the rig's own]",
    ),
]
JsonTarget = Annotated[
    str, typer.Option("--json", metavar="PATH", callback=writable, help="write the result as JSON; - for stdout")
]
