"""`hil compare`: tables, a picture and JSON of all laws on the same task; `--velocity`: of estimators."""

import os
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import JsonTarget, Overrides, ReadRig, Scheduler
from hil.cli.output import drawable, print_plant_notes, write_json
from hil.rig.file import load_rig
from hil.rig.law_names import LAWS
from hil.rig.schema import RigError
from hil.studies.compare.cases import LEARNING, cases, run_all
from hil.studies.compare.report import comparison_table, draw, summary_table
from hil.virtual.sim import usable

WIDTH, WIDTH_PER_AXIS = 50, 40  # characters of a table that goes to a file


def _numbers(text: str) -> list[float]:
    try:
        rates = [float(rate) for rate in text.split(",") if rate.strip()]
    except ValueError:
        raise RigError([f"--rates {text}: expected numbers (Hz) separated by commas"]) from None
    for rate in rates:
        if not 10.0 <= rate <= 10_000.0:
            raise RigError([f"--rates {text}: {rate:g} Hz is outside 10 to 10000 Hz"])
    return rates


def compare(
    rig_file: ReadRig,
    *,
    laws: Annotated[str, typer.Option(help=f"comma-separated; X{LEARNING} is X inside iterative learning")] = "",
    corners: Annotated[bool, typer.Option("--corners", help="five corners of mass and friction")] = False,
    disturbed: Annotated[
        bool, typer.Option("--disturbed/--undisturbed", help="jitter, loss, ripple, Stribeck, reversals off the grid")
    ] = True,
    rates: Annotated[str, typer.Option(help="further rates, Hz, comma-separated; gains scale with them")] = "",
    velocity: Annotated[bool, typer.Option("--velocity", help="velocity estimators instead of laws")] = False,
    seconds: Annotated[float, typer.Option(min=1.0, max=1e6, help="virtual time of each run")] = 20.0,
    overrides: Overrides = None,
    workers: Annotated[int, typer.Option(min=0, help="processes; 0: one per core")] = 0,
    scheduler: Scheduler = "",
    picture: Annotated[
        Path | None, typer.Option(callback=drawable, help="where to draw it [default: runs/RIG-compare.png]")
    ] = None,
    json_target: JsonTarget = "",
) -> None:
    """All control laws (or velocity estimators) on the same task; tables, a picture, and JSON."""
    from rich.progress import track

    from hil.cli.console import plain_console

    changes = list(overrides or ())
    rig = load_rig(rig_file, changes)
    console = plain_console(stderr=json_target == "-")
    if not console.is_terminal:
        console.width = WIDTH + WIDTH_PER_AXIS * len(rig.axes)
    print_plant_notes(console, rig)
    if velocity:
        from hil.studies.compare.velocity_estimators import compare_velocity, velocity_tables

        rows = compare_velocity(usable(rig, rig_file), rig_file.parent, seconds)
        for table in velocity_tables(rig, rows):
            console.print(table)
    else:
        chosen = [name.strip() for name in laws.split(",") if name.strip()] or list(LAWS)
        work = cases(rig_file, chosen, changes, _numbers(rates), corners, disturbed, seconds)
        done = run_all(work, workers or os.cpu_count() or 1, scheduler)
        rows = list(track(done, f"{len(work)} runs", total=len(work), console=console, transient=True))
        console.print(comparison_table(rig, rows))
        console.print(summary_table(rig, rows))
        target = picture or Path("runs") / f"{rig.name}-compare.png"
        draw(target, rig, rows)
        console.print(f"picture: {target}")
    if json_target:
        write_json({"rows": rows}, json_target)
