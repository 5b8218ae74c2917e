"""What `hil inject` prints while a batch runs and at its end, and what it writes beside the CSV file."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from hil.cli.progress import Steps
from hil.studies.inject.batch import Batch, Follower, Injected
from hil.studies.inject.equipment import Positions
from hil.studies.inject.judge import Line, share_text
from hil.studies.inject.sheet import row_of


class Shown(Follower):
    """A step of the progress for each cell; at a terminal with the verdict of the last one."""

    def __init__(self, steps: Steps) -> None:
        self._steps = steps

    def over(self, cell: Injected) -> None:
        """One more."""
        result = cell.result
        self._steps.advance(text=f"cell {result.number + 1}: {result.verdict.name.lower().replace('_', ' ')}")


def show(console: Console, batch: Batch, lines: Sequence[Line]) -> None:
    """Verdicts with their shares, and bars where there are any."""
    counts = Counter(cell.result.verdict.name for cell in batch.cells)
    title = f"{len(batch.cells)} of {batch.planned} cells"
    if batch.earlier:
        title += f", {len(batch.cells) - batch.earlier} of them"
    table = Table("verdict", "cells", "share [95 % interval]", title=f"{title} in {batch.seconds:.1f} s")
    for name, count in counts.most_common():
        table.add_row(name.lower().replace("_", " "), str(count), share_text(count, len(batch.cells)))
    console.print(table)
    if lines:
        show_lines(console, lines)


def show_lines(console: Console, lines: Sequence[Line]) -> None:
    """Bars, and what was reached."""
    if lines:
        bars = Table("bar", "allowed", "reached", "", title="against the specification")
        for line in lines:
            bars.add_row(line.name, line.bar, line.reached, {True: "holds", False: "MISSED", None: ""}[line.holds])
        console.print(bars)


def document(batch: Batch, lines: Sequence[Line], places: Positions) -> dict[str, Any]:
    """For --json: cells as the rows of the CSV file, how the batch ended, bars."""
    return {
        "cells": [row_of(cell, places) for cell in batch.cells],
        "planned": batch.planned,
        "earlier": batch.earlier,
        "seconds": batch.seconds,
        "fault": batch.fault,
        "limited": batch.limited,
        "bars": [line._asdict() for line in lines],
    }
