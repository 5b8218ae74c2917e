"""A batch as one HTML file that needs nothing else: the dish with its verdicts, force over depth, times, shares."""

from collections import Counter
from collections.abc import Sequence
from math import isfinite, isnan
from typing import Final

from hil.control.motion.injection.verdict import Verdict
from hil.rig.schema import RigConfig
from hil.runs.report import HEAD, STYLE, table_html, text_html
from hil.studies.inject.batch import Batch, Injected
from hil.studies.inject.equipment import Positions
from hil.studies.inject.judge import Line, share_text
from hil.telemetry.cell_watch import Trace

COLOURS: Final = {
    Verdict.OK: "#1b7f3b", Verdict.NO_CELL: "#9aa0a6", Verdict.ROLLED: "#7b4fb5", Verdict.NOT_PIERCED: "#c77700",
    Verdict.DOUBLE: "#b00020", Verdict.SENSOR_DEAD: "#00696f", Verdict.CAMERA_FROZEN: "#3367d6",
    Verdict.CLOGGED: "#8d5524", Verdict.STUCK: "#d81b7a", Verdict.BROKEN: "#000000", Verdict.UNKNOWN: "#5f6b7a",
    Verdict.SKIPPED: "#c9b037", Verdict.HELD: "#4f8f00", Verdict.BURST: "#7a0c0c",
}  # fmt: skip
_NOT_YET: Final = "#ffffff"
_WIDTH: Final = 640.0
_EDGE: Final = 50.0
_MOST_TRACES: Final = 200  # drawn; a page of more is too long to look at


def batch_page(rig: RigConfig, batch: Batch, places: Positions, lines: Sequence[Line] = ()) -> str:
    """The page's text. It runs no script, and says of each cell what its file says."""
    title = f"{rig.name}: {len(batch.cells)} of {batch.planned} cells"
    ended = batch.failure or batch.fault or ("all cells are over" if len(batch.cells) == batch.planned else "cut short")
    style = f"{STYLE}svg{{max-width:100%;height:auto;background:#fff}}text{{font:11px system-ui,sans-serif}}"
    parts = [
        f"{HEAD}<title>{text_html(title)}</title><style>{style}</style></head><body><h1>{text_html(title)}</h1>",
        f"<p>{text_html(ended)}; {batch.seconds:.1f} s</p>",
        "<h2>Verdicts</h2>",
        _verdicts(batch.cells),
        "<h2>Dish</h2>",
        _dish(batch.cells, places),
        "<h2>Force over depth</h2>",
        _forces(batch),
        "<h2>Times</h2>",
        _times(batch.cells),
        "<h2>Bars</h2>" if lines else "",
        table_html(["bar", "allowed", "reached", ""], [_bar(line) for line in lines]) if lines else "",
        "<h2>Cells</h2>",
        _cells(batch.cells),
        "</body></html>\n",
    ]
    return "\n".join(part for part in parts if part)


def _word(verdict: Verdict) -> str:
    return verdict.name.lower().replace("_", " ")


def _verdicts(cells: Sequence[Injected]) -> str:
    counts = Counter(cell.result.verdict for cell in cells)
    rows = [[_word(verdict), share_text(count, len(cells))] for verdict, count in counts.most_common()]
    return table_html(["verdict", "cells [95 % interval by Wilson]"], rows)


def _bar(line: Line) -> list[str]:
    return [line.name, line.bar, line.reached, {True: "holds", False: "MISSED", None: ""}[line.holds]]


def _dish(cells: Sequence[Injected], places: Positions) -> str:
    """The cells where they lie, seen from above, each in the colour of its verdict; white: not reached."""
    verdicts = {cell.result.number: cell.result.verdict for cell in cells}
    low = [min(place[axis] for place in places) for axis in range(2)]
    span = max(max(place[axis] for place in places) - low[axis] for axis in range(2)) or 1e-3
    scale = (_WIDTH - 2 * _EDGE) / span
    height = (max(place[1] for place in places) - low[1]) * scale + 2 * _EDGE
    radius = max(3.0, min(18.0, 0.35 * (_WIDTH - 2 * _EDGE) / max(1.0, len(places) ** 0.5)))
    marks = []
    for number, (x, y) in enumerate(places):
        verdict = verdicts.get(number)
        word = "not reached" if verdict is None else _word(verdict)
        colour = _NOT_YET if verdict is None else COLOURS[verdict]
        at = f'cx="{_EDGE + (x - low[0]) * scale:.1f}" cy="{height - _EDGE - (y - low[1]) * scale:.1f}"'
        marks.append(
            f'<circle {at} r="{radius:.1f}" fill="{colour}" stroke="#444"><title>{number + 1}: {word}, '
            f"x {x * 1e3:.3f} mm, y {y * 1e3:.3f} mm</title></circle>"
        )
    return _svg("the dish from above", height, marks) + _legend(set(verdicts.values()))


def _legend(verdicts: set[Verdict]) -> str:
    words = (
        f'<span style="color:{COLOURS[verdict]}">&#9679;</span> {text_html(_word(verdict))}'
        for verdict in sorted(verdicts)
    )
    return f"<p>{' &nbsp; '.join(words)}</p>"


def _svg(name: str, height: float, marks: Sequence[str]) -> str:
    return (
        f'<svg role="img" aria-label="{text_html(name)}" viewBox="0 0 {_WIDTH:g} {height:.0f}" width="{_WIDTH:g}">'
        f"{''.join(marks)}</svg>"
    )


def _forces(batch: Batch) -> str:
    verdicts = {cell.result.number: cell.result.verdict for cell in batch.cells}
    drawn = {number: trace for number, trace in batch.traces.items() if number in verdicts and trace.depth}
    if not drawn:
        return "<p>No trace was kept.</p>"
    shown = dict(sorted(drawn.items())[:_MOST_TRACES])
    points = [point for trace in shown.values() for point in _points(trace)]
    left, right = min(x for x, _ in points), max(x for x, _ in points)
    low, high = min(0.0, *(y for _, y in points)), max(y for _, y in points)
    height = 0.6 * _WIDTH
    x_scale = (_WIDTH - 2 * _EDGE) / ((right - left) or 1e-9)
    y_scale = (height - 2 * _EDGE) / ((high - low) or 1e-9)
    lines = [
        f'<polyline fill="none" stroke="{COLOURS[verdicts[number]]}" stroke-opacity="0.6" points="'
        + " ".join(
            f"{_EDGE + (x - left) * x_scale:.1f},{height - _EDGE - (y - low) * y_scale:.1f}" for x, y in _points(trace)
        )
        + f'"><title>cell {number + 1}: {_word(verdicts[number])}</title></polyline>'
        for number, trace in shown.items()
    ]
    zero = height - _EDGE + low * y_scale
    axes = [
        f'<line x1="{_EDGE}" y1="{zero:.1f}" x2="{_WIDTH - _EDGE}" y2="{zero:.1f}" stroke="#888"/>',
        f'<text x="{_EDGE}" y="{height - 12:.0f}">{left * 1e6:.0f} um</text>',
        f'<text x="{_WIDTH - _EDGE}" y="{height - 12:.0f}" text-anchor="end">{right * 1e6:.0f} um below the stated top'
        "</text>",
        f'<text x="4" y="{_EDGE - 8:.0f}">{high * 1e6:.0f} uN</text><text x="4" y="{zero:.0f}">0</text>',
    ]
    more = f"<p>The first {_MOST_TRACES} of {len(drawn)} cells.</p>" if len(drawn) > _MOST_TRACES else ""
    return _svg("force over depth", height, [*axes, *lines]) + more


def _points(trace: Trace) -> list[tuple[float, float]]:
    found = zip(trace.depth, trace.force, strict=True)
    return [(depth, force) for depth, force in found if isfinite(depth) and isfinite(force)]


def _times(cells: Sequence[Injected]) -> str:
    """A bar a cell: from its approach to its end."""
    spans = [(cell.result, cell.result.ended_s - cell.result.began_s) for cell in cells]
    known = [(result, span) for result, span in spans if isfinite(span)]
    if not known:
        return "<p>No cell has begun and ended.</p>"
    longest = max(span for _, span in known) or 1.0
    height, wide = 160.0, (_WIDTH - 2 * _EDGE) / len(known)
    marks = [f'<text x="4" y="20">{longest:.2f} s</text><text x="4" y="{height - 20:.0f}">0</text>']
    for place, (result, span) in enumerate(known):
        tall = (height - 40.0) * span / longest
        marks.append(
            f'<rect x="{_EDGE + place * wide:.2f}" y="{height - 20.0 - tall:.1f}" width="{max(0.5, 0.8 * wide):.2f}" '
            f'height="{tall:.1f}" fill="{COLOURS[result.verdict]}"><title>cell {result.number + 1}: {span:.3f} s'
            "</title></rect>"
        )
    return _svg("time of each cell", height, marks)


def _cells(cells: Sequence[Injected]) -> str:
    heads = [
        "cell",
        "verdict",
        "s",
        "touch to puncture, um",
        "puncture, uN",
        "peak, uN",
        "depth, um",
        "bolus",
        "evidence",
    ]
    return table_html(heads, [_cell(cell) for cell in cells])


def _cell(cell: Injected) -> list[str]:
    found = cell.result
    numbers = (
        (found.ended_s - found.began_s, 1.0, 2), (abs(found.pierced - found.contact), 1e6, 0),
        (found.pierced_force, 1e6, 0), (found.peak_force, 1e6, 0), (found.deposit, 1e6, 0), (found.bolus, 1.0, 2),
    )  # fmt: skip
    texts = ["-" if isnan(value) else f"{value * scale:.{digits}f}" for value, scale, digits in numbers]
    return [str(found.number + 1), _word(found.verdict), *texts, found.evidence]
