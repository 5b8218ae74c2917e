"""`hil plot`, `hil diff`, `hil export`, `hil report`: runs one can look at. Each says what a method of hil.Run does."""

import contextlib
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NoReturn

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from hil.analysis.figures_of_merit import NOT_SETTLED, Figure
from hil.cli.console import plain_console
from hil.cli.exit_status import EXIT_FILE, EXIT_UNAVAILABLE
from hil.cli.options import JsonTarget
from hil.cli.output import drawable, metres, write_json
from hil.events.table import Kind
from hil.rig.difference import rig_differences
from hil.rig.file import load_rig
from hil.runs.api import EXPORTS, Run, load_run
from hil.runs.baseline import document_of, lines, losses
from hil.runs.last import last_runs, named_or_last
from hil.runs.measured_trend import as_document, show_trends, trends
from hil.telemetry.recording import RecordingError

_RUN = "a recording (run.mcap), the folder that holds one, or an exported .npz"
RunFile = Annotated[Path | None, typer.Argument(metavar="RUN", help=f"{_RUN}; default: the last one below runs/")]
Into = Annotated[Path | None, typer.Option("--out", "-o", help="the file to write [default: beside the run]")]
_FIGURES: tuple[Figure, ...] = ("max_error", "rms_error", "plateau_error", "peak_force", "chatter")


def plot(run: RunFile = None, out: Into = None) -> None:
    """Draw setpoint, following error and force of every axis over time, as .png, .svg, .pdf, ..."""
    run_file = named_or_last(run)
    with _said():
        target = drawable(out) or _beside(run_file, ".png")
        found = load_run(run_file)
        print(found.plot(target))
        tell_loss(run_file, found)


def report(run: RunFile = None, out: Into = None) -> None:
    """Write one HTML file that needs nothing else: figures, pictures, events, law and rig; readable on a phone."""
    run_file = named_or_last(run)
    with _said():
        found = load_run(run_file)
        print(found.report(out or _beside(run_file, ".html")))
        tell_loss(run_file, found)


def export(run: RunFile = None, out: Into = None) -> None:
    """Write the run's columns: .csv or .parquet for people and tables, .npz for `hil` and numpy, bit for bit."""
    run_file = named_or_last(run)
    target = out or _beside(run_file, ".csv")
    if target.suffix not in EXPORTS:
        raise typer.BadParameter(f"{target}: the name must end in {', '.join(EXPORTS)}", param_hint="--out")
    with _said():
        found = load_run(run_file)
        print(found.export(target))
        tell_loss(run_file, found)


def diff(
    first: Annotated[Path | None, typer.Argument(metavar="RUN", help=f"{_RUN}; default: the last two")] = None,
    second: Annotated[Path | None, typer.Argument(metavar="RUN", help="the other; default: the last one")] = None,
    json_target: JsonTarget = "",
) -> None:
    """Compare two runs: keys of the rig, figures, events, and the largest differences by tick.

    Of two rig files, what `hil identify` measured. Exit status 0: every tick is the same, or no value left both
    intervals; 1: they differ; 74: ticks are missing from one of them.
    """
    if first and second and first.suffix == second.suffix == ".toml":
        _diff_measured(first, second, json_target)
        return
    if first is None or second is None:
        chosen = [first] if first else []
        first, second = [*chosen, *last_runs(2 - len(chosen))]
        print(f"hil: {first} and {second}", file=sys.stderr)
    with _said():
        one, other = load_run(first), load_run(second)
        document = differences(one, other)
    console = plain_console(stderr=json_target == "-")
    _show(console, one, document)
    if json_target:
        write_json(document, json_target)
    tell_loss(first, one)
    tell_loss(second, other)
    if not document["same"]:
        raise typer.Exit(1)


def _diff_measured(first: Path, second: Path, json_target: str) -> None:
    one, other = load_rig(first), load_rig(second)
    found = trends(one, other)
    show_trends(plain_console(stderr=json_target == "-"), found, one, other)
    if json_target:
        write_json(as_document(found), json_target)
    if any(trend.left for trend in found):
        raise typer.Exit(1)


def differences(first: Run, second: Run) -> dict[str, Any]:
    """Keys: same (every tick is the same, as far as Run.compare looks), ticks [2], rig (lines), final_state [2],
    events_gone and events_new (texts), both (ticks in which both follow something), settled [2]. Further keys: accuracy
    (lines: where the second is beyond what the first was like, with axis, instant and signature), and per axis in axes:
    largest (as Run.compare), and each figure [2].

    Raises ValueError where the runs have other axes.
    """
    largest = first.compare(second)
    summaries = first.summary(), second.summary()
    texts = [_told(run) for run in (first, second)]
    axes = {
        name: {"largest": row} | {key: [summary["axes"][name][key] for summary in summaries] for key in _FIGURES}
        for name, row in largest.items()
    }
    ticks = [summary["ticks"] for summary in summaries]
    differs = any(value for row in largest.values() for value in row.values())
    return {
        "same": not differs and ticks[0] == ticks[1] and texts[0] == texts[1],
        "ticks": ticks,
        "rig": rig_differences(first.rig, second.rig),
        "final_state": [summary["final_state"] for summary in summaries],
        "events_gone": [text for text in texts[0] if text not in texts[1]],
        "events_new": [text for text in texts[1] if text not in texts[0]],
        "both": _both(first, second),
        "settled": [summary["settled"] for summary in summaries],
        "axes": axes,
        "accuracy": lines(second, losses(second, document_of(first))),
    }


def _told(run: Run) -> list[str]:
    """Its changes of state, its faults, and where its accuracy was lost."""
    lost = [f"accuracy lost: {event.name} on {event.axis}" for event in run.log if event.kind is Kind.ACCURACY_LOST]
    return [*(event.text for event in run.events), *lost]


def _both(first: Run, second: Run) -> int:
    """Ticks in which both follow something on any axis."""
    n = min(len(first.time), len(second.time))
    return int(np.isfinite(first.error[:n] - second.error[:n]).any(axis=1).sum())


def _show(console: Console, run: Run, found: dict[str, Any]) -> None:
    for line in found["rig"]:
        console.print(f"rig    {line}", soft_wrap=True, markup=False, highlight=False)
    for key, sign in (("events_gone", "-"), ("events_new", "+")):
        for text in found[key]:
            console.print(f"event {sign} {text}", soft_wrap=True, markup=False, highlight=False)
    for line in found["accuracy"]:
        console.print(f"accuracy, the second against the first: {line}", soft_wrap=True, markup=False, highlight=False)
    table = Table("axis", "figure", "first", "second", "change")
    for name, row in found["axes"].items():
        kind = run.rig.axes[name].kind
        for key in _FIGURES:
            before, after = row[key]
            shown = [_quantity(value, key, kind) for value in (before, after)]
            change = f"{(after / before - 1.0) * 100.0:+.1f} %" if before and math.isfinite(after / before) else "-"
            table.add_row(name, key.replace("_", " "), *shown, change)
    console.print(table)
    for name, row in found["axes"].items():
        kind = run.rig.axes[name].kind
        parts = (f"{key} {_quantity(value, key, kind)}" for key, value in row["largest"].items())
        console.print(f"{name}, tick by tick, at most: {', '.join(parts)}", highlight=False)
    ticks, states = found["ticks"], found["final_state"]
    for which, settled in zip(("first", "second"), found["settled"], strict=True):
        if not settled:
            console.print(f"figures of the {which} run: {NOT_SETTLED}", highlight=False)
    if found["both"] < max(ticks):
        console.print(f"setpoint and error: of the {found['both']} ticks in which both follow a task", highlight=False)
    console.print(f"{ticks[0]} and {ticks[1]} ticks; ended {states[0]} and {states[1]}", highlight=False)
    console.print("the same, tick by tick" if found["same"] else "they differ")


def _quantity(value: float, key: str, kind: str) -> str:
    if key in ("peak_force", "chatter", "force"):
        return f"{value:.4g} {'N' if kind == 'linear' else 'N m'}"
    return metres(value, kind)


def _beside(run_file: Path, suffix: str) -> Path:
    """runs/A/run.png of runs/A, of runs/A/run.mcap, and of nothing else."""
    return run_file / f"run{suffix}" if run_file.is_dir() else run_file.with_suffix(suffix)


@contextlib.contextmanager
def _said() -> Iterator[None]:
    """What is wrong with a file, or lacks on this machine, as a line of text and an exit status."""
    try:
        yield
    except RecordingError as error:
        _fail(str(error), EXIT_FILE)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    except ImportError as error:
        _fail(f"{error}: pip install 'pandas' 'pyarrow'", EXIT_UNAVAILABLE)


def tell_loss(run_file: Path, run: Run) -> None:
    """Say what is missing from a run, and end with the status of an unreadable file, where anything is."""
    if loss := getattr(run, "loss", ""):
        _fail(f"{run_file}: {loss}", EXIT_FILE)


def _fail(text: str, status: int) -> NoReturn:
    print(f"hil: {text}", file=sys.stderr)
    raise typer.Exit(status)
