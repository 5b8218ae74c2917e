"""`hil inject --compare`: the same cells by every z_law, side by side, told as they are."""

from collections.abc import Callable, Sequence
from math import isnan
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Column, Table

from hil.control.motion.injection.z_laws import Z_LAWS
from hil.studies.inject.batch import Batch
from hil.studies.inject.judge import quantile, share_text, wilson

COMPARED = tuple(name for name in Z_LAWS if name != "hold")  # which pierces nothing


class Compared(NamedTuple):
    """A batch by one z_law. Shares are (hits, of); forces in N, ways in m, each (median, 95 %) or None where it never
    happened; wrong_pulses: into cells that are whole; pace: cells a minute.
    """

    z_law: str
    right: tuple[int, int]
    pierced: tuple[int, int]
    force: tuple[float, float] | None
    further: tuple[float, float] | None
    wrong_pulses: int
    pace: float
    fault: str


def compared(batch_of: Callable[[str], Batch]) -> list[Compared]:
    """One row for each z_law. batch_of: runs the cells by one of them."""
    return [_row(name, batch_of(name)) for name in COMPARED]


def _row(name: str, batch: Batch) -> Compared:
    cells = batch.judged
    good = [cell for cell in cells if cell.anomaly == ""]
    return Compared(
        name,
        (sum(cell.right for cell in cells), len(cells)),
        (sum(cell.result.verdict.name == "OK" for cell in good), len(good)),
        _spread([cell.peak_force for cell in batch.cells]),
        _spread([cell.lurch for cell in batch.cells if not isnan(cell.lurch)]),
        sum(cell.wrong_pulses for cell in batch.cells),
        60.0 * len(batch.cells) / batch.seconds if batch.seconds else 0.0,
        batch.failure or batch.fault,
    )


def _spread(values: Sequence[float]) -> tuple[float, float] | None:
    return (quantile(values, 0.5), quantile(values, 0.95)) if values else None


def show_compared(console: Console, rows: Sequence[Compared], speed: str) -> None:
    """As a table; a batch that a fault ended is named below it."""
    table = Table(
        Column("z_law", no_wrap=True), "verdicts right", "good cells injected", "force, mN", "further on, um",
        "wrong pulses", "a minute",
        title=f"the same cells by every z_law, {speed}; median / 95 %, shares with 95 % intervals",
    )  # fmt: skip
    for row in rows:
        shares = [share_text(*share) if share[1] else "none" for share in (row.right, row.pierced)]
        force, further = (_text(pair, scale) for pair, scale in ((row.force, 1e3), (row.further, 1e6)))
        table.add_row(row.z_law, *shares, force, further, str(row.wrong_pulses), f"{row.pace:.0f}")
    console.print(table)
    for row in rows:
        if row.fault:
            console.print(f"{row.z_law}: ended by {row.fault}")


def _text(pair: tuple[float, float] | None, scale: float) -> str:
    return "none" if pair is None else f"{pair[0] * scale:.2f} / {pair[1] * scale:.2f}"


def compared_document(rows: Sequence[Compared]) -> list[dict[str, Any]]:
    """For --json: shares with their intervals."""
    return [
        {**row._asdict(), "right_interval": _interval(row.right), "pierced_interval": _interval(row.pierced)}
        for row in rows
    ]


def _interval(share: tuple[int, int]) -> tuple[float, float] | None:
    return wilson(*share) if share[1] else None
