"""Output helpers shared by all commands: JSON, lengths for people, the table of axes."""

import contextlib
import json
import math
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import typer
from rich.console import Console
from rich.table import Table

from drivers.base.named_file import naming, write_text
from hil.rig.plant_notes import plant_notes
from hil.rig.schema import RigConfig

PICTURES = (".png", ".svg", ".pdf", ".eps", ".jpg", ".jpeg", ".tiff", ".webp")  # suffixes that matplotlib writes


def writable(target: str | None) -> str | None:
    """Option callback for a file to write: refuse it before a long run rather than fail after it.

    Raises typer.BadParameter.
    """
    if target and target != "-":
        path = Path(target)
        if not path.parent.is_dir():
            raise typer.BadParameter(f"{target}: there is no folder {path.parent}")
        if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
            raise typer.BadParameter(f"{target}: cannot be written")
    return target


def drawable(picture: Path | None) -> Path | None:
    """Option callback for a picture to write. Raises typer.BadParameter."""
    if picture and picture.suffix.lower() not in PICTURES:
        raise typer.BadParameter(f"{picture}: the name must end in one of {', '.join(PICTURES)}")
    return picture


def replace_text(path: Path, text: str) -> None:
    """Replace a file's text, keeping owner, group and mode; on failure the old file is left as it was. Raises
    OSError.
    """
    place = path.resolve()  # replace what a symbolic link points to, not the link
    draft = place.with_name(f"{place.name}.{os.getpid()}.new")
    try:
        with naming(place):
            draft.write_text(text, encoding="utf-8")
        old = place.stat()
        with contextlib.suppress(OSError):  # only root may change the owner; otherwise this user owns it
            os.chown(draft, old.st_uid, old.st_gid)
        shutil.copymode(place, draft)
        draft.replace(place)
    except OSError:
        draft.unlink(missing_ok=True)
        raise


def write_json(document: Any, target: str) -> None:
    """Write JSON (NaN as null) to a path, or to standard output for '-'."""
    text = json.dumps(_without_nan(document), indent=2) + "\n"
    if target == "-":
        sys.stdout.write(text)
    else:
        write_text(target, text)


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def print_plant_notes(console: Console, rig: RigConfig) -> None:
    """For commands that simulate: what of the emulated stage the rig file leaves to the nominal model, or states to be
    unlike it.
    """
    for note in plant_notes(rig):
        console.print(note, soft_wrap=True, markup=False, highlight=False)


def metres(value: float, kind: str = "linear") -> str:
    """A small length (or angle) for people."""
    unit = "m" if kind == "linear" else "rad"
    if not math.isfinite(value):
        return "-"
    for scale, prefix in ((1.0, ""), (1e-3, "m"), (1e-6, "µ")):
        if abs(value) >= scale:
            return f"{value / scale:.3g} {prefix}{unit}"
    return f"{round(value / 1e-9, 3):.3g} n{unit}"  # less than that is rounding, not motion


def axis_table(rig: RigConfig, axes: dict[str, dict[str, float]], title: str) -> Table:
    """Per axis: errors, peak force, chatter."""
    table = Table(
        "axis", "max error", "RMS error", "plateau", "peak force", "chatter", title=title, title_justify="left"
    )
    for name, row in axes.items():
        kind = rig.axes[name].kind
        force = "N" if kind == "linear" else "N m"
        table.add_row(
            name,
            metres(row["max_error"], kind),
            metres(row["rms_error"], kind),
            metres(row["plateau_error"], kind),
            f"{row['peak_force']:.3g} {force}",
            f"{row['chatter']:.3g} {force}",
        )
    return table
