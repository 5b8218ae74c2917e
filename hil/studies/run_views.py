"""`hil plot`, `hil diff`, `hil export`, `hil report`: runs one can look at. Each says what a method of hil.Run does."""

import contextlib
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.table import Table

from hil.cli.exit_status import EXIT_FILE, EXIT_UNAVAILABLE
from hil.cli.output import drawable, metres, writable, write_json
from hil.rig.difference import rig_differences
from hil.runs import EXPORTS, Run, load_run
from hil.telemetry.recording import RecordingError

RunFile = Annotated[
    Path,
    typer.Argument(
        metavar="RUN", show_default=False, help="a recording (run.mcap), the folder that holds one, or an exported .npz"
    ),
]
Into = Annotated[Path | None, typer.Option("--out", "-o", help="the file to write [default: beside the run]")]
_FIGURES = ("max_error", "rms_error", "plateau_error", "peak_force", "chatter")


def plot(run_file: RunFile, out: Into = None) -> None:
    """Draw setpoint, following error and force of every axis over time, as .png, .svg, .pdf, ..."""
    with _said():
        target = drawable(out) or _beside(run_file, ".png")
        print(load_run(run_file).plot(target))


def report(run_file: RunFile, out: Into = None) -> None:
    """Write one HTML file that needs nothing else: figures, pictures, events, law and rig; readable on a phone."""
    with _said():
        print(load_run(run_file).report(out or _beside(run_file, ".html")))


def export(run_file: RunFile, out: Into = None) -> None:
    """Write the run's columns: .csv or .parquet for people and tables, .npz for `hil` and numpy, bit for bit."""
    target = out or _beside(run_file, ".csv")
    if target.suffix not in EXPORTS:
        raise typer.BadParameter(f"{target}: the name must end in {', '.join(EXPORTS)}", param_hint="--out")
    with _said():
        print(load_run(run_file).export(target))


def diff(
    first: RunFile,
    second: RunFile,
    json_target: Annotated[
        str, typer.Option("--json", callback=writable, help="write it there; - for standard output")
    ] = "",
) -> None:
    """What is otherwise in the second run: keys of the rig, figures, events, and the largest differences by tick.

    Exit status 0: every tick is the same; 1: they differ.
    """
    with _said():
        one, other = load_run(first), load_run(second)
        document = differences(one, other)
    console = Console(stderr=json_target == "-")
    _show(console, one, document)
    if json_target:
        write_json(document, json_target)
    if not document["same"]:
        raise typer.Exit(1)


def differences(first: Run, second: Run) -> dict[str, Any]:
    """Keys: same (every tick is the same, as far as Run.compare looks), ticks [2], rig (lines), final_state [2],
    events_gone and events_new (texts), and per axis in axes: largest (as Run.compare), and each figure [2].

    Raises ValueError where the runs have other axes.
    """
    largest = first.compare(second)
    summaries = first.summary(), second.summary()
    texts = [[event.text for event in run.events] for run in (first, second)]
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
        "axes": axes,
    }


def _show(console: Console, run: Run, found: dict[str, Any]) -> None:
    for line in found["rig"]:
        console.print(f"rig    {line}", soft_wrap=True, markup=False, highlight=False)
    for key, sign in (("events_gone", "-"), ("events_new", "+")):
        for text in found[key]:
            console.print(f"event {sign} {text}", soft_wrap=True, markup=False, highlight=False)
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


def _fail(text: str, status: int) -> NoReturn:
    print(f"hil: {text}", file=sys.stderr)
    raise typer.Exit(status)
