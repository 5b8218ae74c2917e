"""What all benchmarks share: interleaved blocks, spreads, the machine's facts, a table and JSON.

A figure means little on a machine that stalls now and then, and nothing on somebody else's. So every benchmark runs its
subject and its reference in turns (A B, B A, A B, ...), reports min, median and max over the blocks, and prints what it
ran on. Ratios are formed inside a block pair before the median is taken: both were disturbed alike.
"""

from collections.abc import Callable, Mapping, Sequence
from statistics import median
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from numpy.typing import ArrayLike
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from hil.cli.console import plain_console
from hil.cli.output import writable, write_json
from hil.operate.machine import machine_facts

Figures = dict[str, float]
JsonTarget = Annotated[str | None, typer.Option("--json", callback=writable, help="file, or - for stdout")]


class Case(NamedTuple):
    """One subject of a benchmark. run(): measures one block and returns its figures, each named with its unit."""

    name: str
    run: Callable[[], Figures]


class Block(NamedTuple):
    """What one run of one case measured."""

    case: str
    number: int
    figures: Figures


class Spread(NamedTuple):
    """Smallest, median and largest value over the blocks."""

    min: float
    median: float
    max: float


def spread(values: Sequence[float]) -> Spread:
    """Spread of `values`; raises ValueError when there are none."""
    return Spread(min(values), median(values), max(values))


def percentiles(values: ArrayLike) -> Figures:
    """p50, p99, p999 and max of one block's samples, in their own unit."""
    data = np.asarray(values, dtype=np.float64)
    p50, p99, p999 = np.percentile(data, (50, 99, 99.9))
    return {"p50": float(p50), "p99": float(p99), "p999": float(p999), "max": float(data.max())}


def interleave(cases: Sequence[Case], blocks: int) -> list[Block]:
    """Run every case `blocks` times, in turns; every second round in reverse order, so that a drift favours nobody."""
    measured = []
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=plain_console(stderr=True),
        transient=True,
    )
    with bar:
        task = bar.add_task("", total=blocks * len(cases))
        for number in range(blocks):
            for case in cases if number % 2 == 0 else tuple(reversed(cases)):
                bar.update(task, description=f"{case.name}, block {number + 1}")
                measured.append(Block(case.name, number, case.run()))
                bar.advance(task)
    return measured


def values_of(blocks: Sequence[Block], case: str, figure: str) -> list[float]:
    """One figure of one case, by block number."""
    return [b.figures[figure] for b in sorted(blocks, key=lambda b: b.number) if b.case == case]


def ratios(blocks: Sequence[Block], case: str, reference: str, figure: str) -> list[float]:
    """case / reference of one figure, block by block."""
    pairs = zip(values_of(blocks, case, figure), values_of(blocks, reference, figure), strict=True)
    return [subject / base for subject, base in pairs]


def block_table(title: str, blocks: Sequence[Block], figures: Sequence[str], digits: int = 1) -> Table:
    """One row per case and figure: min, median and max over the blocks."""
    table = Table(title=title)
    table.add_column("case")
    table.add_column("figure")
    for heading in ("min", "median", "max"):
        table.add_column(heading, justify="right")
    for case in dict.fromkeys(b.case for b in blocks):
        known = [f for f in figures if all(f in b.figures for b in blocks if b.case == case)]
        for row, figure in enumerate(known):
            cells = (f"{value:.{digits}f}" for value in spread(values_of(blocks, case, figure)))
            table.add_row(case if row == 0 else "", figure, *cells)
    return table


def publish(
    result: Mapping[str, Any], tables: Sequence[Table], json_path: str | None, lines: Sequence[str] = ()
) -> None:
    """Print tables, lines and the machine's facts; write `result` and the facts as JSON to a file, "-" for stdout."""
    facts = machine_facts()
    console = plain_console(stderr=json_path == "-")
    for table in tables:
        console.print(table)
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True)
    shown = ", ".join(f"{key} {value}" for key, value in facts.items() if value not in ("", None))
    console.print(f"machine: {shown}", highlight=False, soft_wrap=True)
    if json_path is not None:
        write_json({**result, "machine": facts}, json_path)


def as_json(blocks: Sequence[Block]) -> list[dict[str, Any]]:
    """All blocks, in the order in which they ran."""
    return [{"case": b.case, "block": b.number, **b.figures} for b in blocks]
