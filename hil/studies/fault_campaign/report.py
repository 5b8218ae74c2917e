"""The campaign's outcome: a matrix for the terminal, an HTML page, JSON."""

import html
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from rich.table import Column, Table

from drivers.base.named_file import write_text
from hil.studies.fault_campaign.matrix import Cell


def document(cells: Sequence[Cell]) -> dict[str, Any]:
    """JSON: cells, passed, failed[], worst_detection_ticks per fault, blind (cells per layout and reason in which the
    layout cannot tell the fault from the truth), and every cell in `matrix`.
    """
    worst: dict[str, int] = {}
    for cell in cells:
        if cell.fault and cell.detection_ticks >= 0:
            worst[cell.fault] = max(worst.get(cell.fault, 0), cell.detection_ticks)
    return {
        "cells": len(cells),
        "passed": sum(cell.passed for cell in cells),
        "failed": [vars(cell) for cell in cells if not cell.passed],
        "worst_detection_ticks": dict(sorted(worst.items())),
        "blind": blind(cells),
        "matrix": [vars(cell) for cell in cells],
    }


def blind(cells: Sequence[Cell]) -> dict[str, dict[str, int]]:
    """Cells by layout and by what it lacks to tell the fault from the truth."""
    counts: dict[str, dict[str, int]] = {}
    for cell in cells:
        if cell.lacking:
            row = counts.setdefault(cell.layout, {})
            row[cell.lacking] = row.get(cell.lacking, 0) + 1
    return counts


def blind_lines(cells: Sequence[Cell]) -> list[str]:
    """The same for people; nothing where every fault can be told."""
    return [
        f"{layout}: {reason}: {count} cells in which less is demanded (docs/safety.md)"
        for layout, reasons in blind(cells).items()
        for reason, count in reasons.items()
    ]


def led_out_lines(cells: Sequence[Cell]) -> list[str]:
    """In how many cells the tip was led out, and how long it took at most; nothing where it never was."""
    took = [cell.out_ticks for cell in cells if cell.out_ticks >= 0]
    return [f"the tip was led out in {len(took)} cells, in at most {max(took)} ticks"] if took else []


def _unique(values: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(values))


def matrix(cells: Sequence[Cell]) -> dict[str, dict[str, list[Cell]]]:
    """Cells by trial, then by layout, rig and checkpoint."""
    table: dict[str, dict[str, list[Cell]]] = {name: {} for name in _unique(cell.trial for cell in cells)}
    for cell in cells:
        table[cell.trial].setdefault(_point(cell), []).append(cell)
    return table


def _point(cell: Cell) -> str:
    return f"{cell.rig}, {cell.layout}: {cell.checkpoint}"


def terminal_table(cells: Sequence[Cell]) -> Table:
    """One line per trial: cells, failures, those in which the layout cannot tell the fault from the truth, what was
    latched, the slowest detection, the greatest force after it.
    """
    table = Table(
        Column("injected", no_wrap=True),
        "cells",
        "failed",
        "cannot tell",
        Column("latched", overflow="fold"),
        "worst ticks",
        "peak after",
        title="fault campaign",
        title_justify="left",
    )
    for trial, columns in matrix(cells).items():
        row = [cell for column in columns.values() for cell in column]
        failed = sum(not cell.passed for cell in row)
        cannot = sum(bool(cell.lacking) for cell in row)
        latched = ", ".join(_unique(cell.fault for cell in row if cell.fault and cell.detection_ticks >= 0)) or "-"
        ticks = max((cell.detection_ticks for cell in row), default=-1)
        peak = max((cell.peak_force_after for cell in row), default=0.0)
        table.add_row(
            trial,
            str(len(row)),
            f"[red]{failed}[/red]" if failed else "0",
            str(cannot) if cannot else "-",
            latched,
            str(ticks) if ticks >= 0 else "-",
            f"{peak:.3g}",
        )
    return table


_STYLE = """body{font:14px sans-serif}table{border-collapse:collapse}td,th{border:1px solid #ccc;padding:2px
5px;font-size:12px}
th.p{writing-mode:vertical-rl;transform:rotate(180deg);text-align:left}td.ok{background:#cfeecf}td.bad{background:#f5a3a3}td.quiet{background:#eef3ee}
td.blind{background:#e8dcb5}"""


def write_html(cells: Sequence[Cell], path: Path) -> None:
    """The whole matrix, one square per trial and checkpoint; hover for what was seen on each axis."""
    points = _unique(map(_point, cells))
    head = "".join(f"<th class=p>{html.escape(point)}</th>" for point in points)
    rows = []
    for trial, columns in matrix(cells).items():
        squares = "".join(_square(columns.get(point, [])) for point in points)
        rows.append(f"<tr><th>{html.escape(trial)}</th>{squares}</tr>")
    failed = sum(not cell.passed for cell in cells)
    page = (
        f"<!doctype html><meta charset=utf-8><title>fault campaign</title><style>{_STYLE}</style>"
        f"<h1>{len(cells)} cells, {failed} failed</h1><p>Number: ticks from injection to detection (worst axis). "
        f"Grey: nothing to detect, nothing happened. Sand: the layout cannot tell the fault from the truth.</p>"
        f"<table><tr><th></th>{head}</tr>{''.join(rows)}</table>"
    )
    write_text(path, page)


def _square(cells: Sequence[Cell]) -> str:
    if not cells:
        return "<td></td>"
    ticks = max(cell.detection_ticks for cell in cells)
    kind = "blind" if any(cell.lacking for cell in cells) else "ok" if ticks >= 0 else "quiet"
    kind = "bad" if any(not cell.passed for cell in cells) else kind
    lines = [
        f"{c.axis}: {c.fault or 'nothing'} after {c.detection_ticks}, ended {c.end} {c.lacking} {c.why}" for c in cells
    ]
    return f'<td class={kind} title="{html.escape(chr(10).join(lines), quote=True)}">{ticks if ticks >= 0 else ""}</td>'
