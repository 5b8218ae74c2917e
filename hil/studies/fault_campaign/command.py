"""`hil faults`: the whole campaign, over all cores."""

import functools
import os
import sys
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from hil.cli.console import plain_console
from hil.cli.options import JsonTarget, Overrides, Scheduler, any_rig
from hil.cli.output import print_plant_notes, write_json
from hil.rig.file import load_rig
from hil.rig.shipped import names
from hil.studies.fault_campaign.campaign import campaign
from hil.studies.fault_campaign.catalogue import TRIALS
from hil.studies.fault_campaign.happenings import HAPPENINGS
from hil.studies.fault_campaign.injection import injection_campaign
from hil.studies.fault_campaign.report import blind_lines, document, led_out_lines, terminal_table, write_html

PAPER = 150  # columns of a table that no terminal bounds


def _trials(only: str) -> str:
    known = [*(trial.name for trial in TRIALS), *(happening.name for happening in HAPPENINGS)]
    if not any(only in name for name in known):
        raise typer.BadParameter(f"{only!r}: in no trial's name; they are: {', '.join(known)}")
    return only


def faults(
    context: typer.Context,
    rigs: Annotated[
        list[Path] | None,
        typer.Argument(help="rig files, or names of shipped or running ones; default: all shipped ones"),
    ] = None,
    *,
    overrides: Overrides = None,
    stride: Annotated[int, typer.Option(min=1, help="try every n-th cell only")] = 1,
    only: Annotated[str, typer.Option(callback=_trials, help="only trials whose names contain this")] = "",
    workers: Annotated[int, typer.Option(min=0, help="processes; 0: one per core")] = 0,
    scheduler: Scheduler = "",
    injection: Annotated[
        bool, typer.Option("--injection", help="instead: all that may happen in each phase of a cell's injection")
    ] = False,
    motion: Annotated[
        bool,
        typer.Option("--motion", help="instead: every fault while goals move the axes"),
    ] = False,
    json_target: JsonTarget = "",
    page: Annotated[Path | None, typer.Option("--html", help="write the matrix as a page")] = None,
) -> None:
    """Inject every fault in every state and phase on every axis, in lockstep, and hold the outcome against the table of
    faults. With --motion: in hold, move, jog, stream, halt, path and pause.

    Exit status 1 when a cell fails.
    """
    if injection and motion:
        raise typer.BadParameter("--injection and --motion are two campaigns; name one of them")
    paths = [path for rig in rigs or map(Path, names("rigs")) if (path := any_rig(context, rig))]
    console = plain_console(stderr=json_target == "-")
    if not console.is_terminal:
        console = plain_console(stderr=json_target == "-", width=PAPER)
    for path in paths:
        print_plant_notes(console, load_rig(path, overrides or ()))
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    started = time.perf_counter()
    with Progress(*columns, console=console, transient=True) as bar:
        job = bar.add_task("cells", total=None)
        found = injection_campaign if injection else functools.partial(campaign, motion=motion)
        cells = found(
            paths,
            stride,
            workers or os.cpu_count() or 1,
            lambda n, total: bar.update(job, completed=n, total=total),
            overrides or (),
            only,
            scheduler,
        )
    outcome = document(cells)
    console.print(terminal_table(cells))
    for cell in [cell for cell in cells if not cell.passed][:40]:
        console.print(f"[red]failed[/red] {cell.rig}: {cell.checkpoint} / {cell.trial} / {cell.axis}: {cell.why}")
    seconds = time.perf_counter() - started
    for line in (*blind_lines(cells), *led_out_lines(cells)):
        console.print(line)
    console.print(f"{outcome['passed']} of {outcome['cells']} cells passed in {seconds:.0f} s")
    if page:
        write_html(cells, page)
        console.print(f"matrix: {page}")
    if json_target:
        write_json(outcome, json_target)
    sys.exit(0 if outcome["passed"] == outcome["cells"] else 1)
