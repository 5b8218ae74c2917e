"""`hil inject`: a batch of cells in virtual time, with the rig's own law, limits and bus."""

import csv
import io
import sys
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from drivers.protocols.base import HostProtocol
from hil.cli.options import JsonTarget, Overrides, RigFile
from hil.cli.output import writable, write_json
from hil.rig.bus_load import refuse_unschedulable, rig_layout
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.studies.inject.batch import Batch, Injected
from hil.studies.inject.batch import inject as inject_batch
from hil.studies.inject.equipment import MOST_CELLS, Positions, grid, has_equipment, middle, read_positions, words
from hil.studies.inject.judge import Line, judged, share_text


def inject(
    rig_file: RigFile,
    *,
    cells: Annotated[Path | None, typer.Option(help="CSV file with x and y of each cell, m")] = None,
    grid_text: Annotated[str, typer.Option("--grid", metavar="RxC", help="rows and columns of cells")] = "4x5",
    pitch: Annotated[float, typer.Option(min=1e-5, max=0.1, help="between the cells of a grid, m")] = 1e-3,
    anomalies: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="share of cells that are not as they should be")
    ] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="of the emulated dish")] = 1,
    judge: Annotated[bool, typer.Option("--judge", help="print the bars; exit status 1 where one is missed")] = False,
    csv_target: Annotated[
        str, typer.Option("--csv", metavar="PATH", callback=writable, help="write a line for each cell")
    ] = "",
    json_target: JsonTarget = "",
    overrides: Overrides = None,
) -> None:
    """Inject a batch of cells in virtual time: approach, touch, puncture, pulse, and a verdict for each cell.

    Nothing real moves. A rig whose [motion] is not "cells" gets reference equipment for the time of the run: a force
    sensor, a camera, a valve and a dish of cells, all of them assumed. Exit status 1 where the batch does not end.
    """
    rig = load_rig(rig_file, overrides or ())
    centre = middle(rig)
    places = _grid(grid_text, pitch, centre) if cells is None else read_positions(cells)
    if len(places) > MOST_CELLS:
        raise RigError([f"{len(places)} cells; allowed: up to {MOST_CELLS}"])
    layout = rig_layout(rig, rig_file.parent)
    changed = load_rig(rig_file, (*(overrides or ()), *words(rig, places, seed, anomalies, fd=layout.fd)))
    layout = refuse_unschedulable(changed, rig_file.parent, layout)
    console = Console(stderr=json_target == "-")
    if not has_equipment(rig):
        console.print("The rig names no motion for cells: with the reference sensors, valve and dish, all assumed.")
    batch = _run(changed, rig_file.parent, layout, console)
    limit = float(changed.motion.parameters.get("force_limit", 1.4e-3))
    lines = judged(batch, limit) if judge else []
    _show(console, batch, lines)
    if csv_target:
        Path(csv_target).write_text(_csv(batch), encoding="utf-8")
        console.print(f"cells: {csv_target}")
    if json_target:
        write_json(_document(batch, lines), json_target)
    if batch.fault or len(batch.cells) < batch.planned:
        why = batch.failure or batch.fault or "the tip is broken"
        print(f"hil inject: {len(batch.cells)} of {batch.planned} cells: {why}", file=sys.stderr)
        sys.exit(1)
    if any(line.holds is False for line in lines):
        sys.exit(1)


def _grid(text: str, pitch: float, centre: tuple[float, float]) -> Positions:
    rows, cross, columns = text.partition("x")
    if not (cross and rows.isdigit() and columns.isdigit() and 0 < int(rows) <= 50 and 0 < int(columns) <= 50):
        raise RigError([f"--grid {text!r}: expected ROWSxCOLUMNS such as 4x5, each from 1 to 50"])
    return grid(int(rows), int(columns), pitch, centre)


def _run(rig: RigConfig, folder: Path, layout: HostProtocol, console: Console) -> Batch:
    columns = (TextColumn("cells"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=None)
        return inject_batch(rig, folder, lambda done, of: bar.update(task, completed=done, total=of), layout)


def _show(console: Console, batch: Batch, lines: list[Line]) -> None:
    counts = Counter(cell.result.verdict.name for cell in batch.cells)
    table = Table(
        "verdict", "cells", "share [95 % interval]", title=f"{len(batch.cells)} cells in {batch.seconds:.1f} s"
    )
    for name, count in counts.most_common():
        table.add_row(name.lower().replace("_", " "), str(count), share_text(count, len(batch.cells)))
    console.print(table)
    if lines:
        bars = Table("bar", "allowed", "reached", "", title="against the specification")
        for line in lines:
            bars.add_row(line.name, line.bar, line.reached, {True: "holds", False: "MISSED", None: ""}[line.holds])
        console.print(bars)


def _row(cell: Injected) -> dict[str, Any]:
    found = asdict(cell.result)
    found["verdict"] = cell.result.verdict.name.lower()
    truth = asdict(cell)
    del truth["result"]
    truth["expected"] = cell.expected.name.lower()
    return {**found, **{f"true_{name}" if name == "peak_force" else name: value for name, value in truth.items()}}


def _csv(batch: Batch) -> str:
    """SI units; verdicts in words; empty where something did not happen."""
    rows = [_row(cell) for cell in batch.cells]
    text = io.StringIO()
    if rows:
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows({k: "" if v != v else v for k, v in row.items()} for row in rows)
    return text.getvalue()


def _document(batch: Batch, lines: list[Line]) -> dict[str, Any]:
    return {
        "cells": [_row(cell) for cell in batch.cells],
        "planned": batch.planned,
        "seconds": batch.seconds,
        "fault": batch.fault,
        "limited": batch.limited,
        "bars": [line._asdict() for line in lines],
    }
