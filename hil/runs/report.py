"""A run as one HTML file that needs nothing else: figures, events, pictures, rig and law, readable on a phone."""

import base64
import html
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from hil.analysis.figures_of_merit import NOT_SETTLED
from hil.cli.output import metres
from hil.cli.pictures import Tracked, axis_svg
from hil.rig.schema import RigConfig

MOST_EVENTS = 500  # shown one by one
STYLE = """
body{font:16px/1.4 system-ui,sans-serif;margin:0 auto;max-width:60rem;padding:.5rem 1rem}
h1{font-size:1.4rem}h2{font-size:1.1rem;margin-top:2rem}
div{overflow-x:auto}table{border-collapse:collapse}
th,td{border-bottom:1px solid #ddd;padding:.25rem .6rem;text-align:left;vertical-align:top}
img{width:100%;max-width:40rem;display:block}pre{overflow-x:auto;background:#f6f6f6;padding:.6rem;font-size:.8rem}
.bad{color:#b00020;font-weight:bold}
"""
HEAD = (
    '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
    '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; img-src data:; '
    "style-src 'unsafe-inline'\">"
    '<meta name="viewport" content="width=device-width,initial-scale=1">'
)


class Story(NamedTuple):
    """What a page tells beside the pictures. summary: as Run.summary gives it. events: time (s) and text of each.
    facts: whatever else is known, by name. failure: why a user's law no longer counted, or empty. latched: the event of
    the fault that the run ended with, or empty.
    """

    summary: Mapping[str, Any]
    events: Sequence[tuple[float, str]]
    facts: Mapping[str, Any]
    failure: str = ""
    latched: str = ""


def report_page(rig: RigConfig, run: Tracked, story: Story) -> str:
    """The page's text. Everything that comes from a rig file or a recording is escaped; the page runs no script."""
    title = f"{rig.name}: {rig.law.name} at {rig.rate_hz:g} Hz"
    parts = [
        f"{HEAD}<title>{text_html(title)}</title><style>{STYLE}</style></head><body><h1>{text_html(title)}</h1>",
        f"<p>{text_html(rig.description)}</p>" if rig.description else "",
        f'<p class="bad">{text_html(story.latched)}</p>' if story.latched else "",
        f'<p class="bad">{text_html(story.failure)}</p>' if story.failure else "",
        table_html([], _verdict(story)),
        "<h2>Steady window</h2>" if story.summary["settled"] else f"<h2>Figures ({NOT_SETTLED})</h2>",
        table_html(
            ["axis", "max error", "RMS error", "plateau", "peak force", "chatter"], _figures(rig, story.summary)
        ),
        *_pictures(rig, run),
        "<h2>Events</h2>",
        table_html(["s", "event"], [[f"{time:.4f}", text] for time, text in story.events[:MOST_EVENTS]]),
        f"<p>and {len(story.events) - MOST_EVENTS} more</p>" if len(story.events) > MOST_EVENTS else "",
        "<h2>Law</h2>",
        table_html([], [["law", rig.law.name], *([key, value] for key, value in rig.law.effective_gains().items())]),
        f"<pre>{text_html(rig.law.source)}</pre>" if rig.law.source else "",  # of a package, the digest of its code
        f"<h2>Estimator</h2><pre>{text_html(rig.estimator.source)}</pre>" if rig.estimator.source else "",
        "<h2>Rig</h2>",
        f"<pre>{text_html(_document(rig))}</pre></body></html>\n",
    ]
    return "\n".join(part for part in parts if part)


def _verdict(story: Story) -> list[list[Any]]:
    summary = story.summary
    known = {
        "ended": summary["final_state"] or "-",
        "faults": ", ".join(summary["faults"]) or "none",
        "lasted": f"{summary['seconds']:.3f} s, {summary['ticks']} ticks",
    }
    return [[key, value] for key, value in {**known, **story.facts}.items()]


def _figures(rig: RigConfig, summary: Mapping[str, Any]) -> Iterable[list[str]]:
    for name, row in summary["axes"].items():
        kind = rig.axes[name].kind
        unit = "N" if kind == "linear" else "N m"
        lengths = [metres(row[key], kind) for key in ("max_error", "rms_error", "plateau_error")]
        forces = [f"{row[key]:.3g} {unit}" if math.isfinite(row[key]) else "-" for key in ("peak_force", "chatter")]
        yield [name, *lengths, *forces]


def _pictures(rig: RigConfig, run: Tracked) -> Iterable[str]:
    for index, name in enumerate(rig.axis_names):
        data = base64.b64encode(axis_svg(rig, run, index).encode()).decode()
        yield f'<img alt="axis {text_html(name)} over time" src="data:image/svg+xml;base64,{data}">'


def table_html(heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table; every cell is escaped."""
    head = "".join(f"<th>{text_html(text)}</th>" for text in heads)
    body = "".join("<tr>" + "".join(f"<td>{text_html(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<div><table>{f'<tr>{head}</tr>' if head else ''}{body}</table></div>"


def _document(rig: RigConfig) -> str:
    """The rig as it was validated, without the texts of files that are shown elsewhere or are long."""
    document = rig.model_dump(mode="json", exclude={"law": {"source"}, "estimator": {"source"}, "task": {"samples"}})
    return json.dumps(document, indent=1)


def text_html(value: Any) -> str:
    """Escaped, also for attributes."""
    return html.escape(str(value), quote=True)
