"""`hil baseline RUN`: keep what a sound run is like, so that later runs of the rig and task are held against it."""

import sys
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from hil.cli.console import plain_console
from hil.cli.exit_status import EXIT_FILE
from hil.cli.options import JsonTarget
from hil.cli.output import metres, write_json
from hil.events.accuracy import AccuracyWatch, Loss
from hil.events.axis_model import ROTARY, axis_models
from hil.events.baseline import baseline_of, known_of
from hil.events.table import Kind
from hil.rig.baseline_file import baseline_path, forget_baseline, read_baseline, write_baseline
from hil.rig.schema import RigConfig
from hil.runs.api import Run, load_run
from hil.runs.last import named_or_last
from hil.telemetry.recording import RecordingError


def baseline(
    run: Annotated[
        Path | None, typer.Argument(metavar="RUN", help="folder of a run, or a recording; default: the last one")
    ] = None,
    *,
    check: Annotated[bool, typer.Option("--check", help="hold the run against the baseline that is kept")] = False,
    forget: Annotated[bool, typer.Option("--forget", help="of the run's rig and task: keep none any more")] = False,
    json_target: JsonTarget = "",
) -> None:
    """Keep what a sound run is like: error, spectrum, innovation, counts and force of every axis at rest, in motion and
    where it turns round.

    Later runs of the same rig, task, law and rate are held against it while they run: live, and by hil sim. What is
    beyond it is an event `accuracy lost`, and stops nothing.

    Exit status 1: --check found an axis beyond the baseline; 74: the run cannot be read, or is no sound one.
    """
    named = named_or_last(run)
    try:
        found = load_run(named)
        if forget:
            print("forgotten" if forget_baseline(found.rig) else "there was none")
        elif check:
            _check(named, found, json_target)
        else:
            _keep(named, found, json_target)
    except RecordingError as error:
        print(f"hil baseline: {error}", file=sys.stderr)
        raise typer.Exit(EXIT_FILE) from None


def _keep(named: Path, run: Run, json_target: str) -> None:
    """Raises RecordingError where the run is no sound one."""
    if wrong := next((event.line for event in run.log if event.kind in (Kind.FAULT_LATCHED, Kind.ACCURACY_LOST)), ""):
        raise RecordingError(f"{named}: no sound run: {wrong}")
    document = document_of(run)
    if not any(document["axes"].values()):
        raise RecordingError(f"{named}: nothing was followed for long enough; a task must run for some seconds")
    path = write_baseline(run.rig, {"run": str(named.resolve()), "made_ns": time.time_ns(), **document})
    console = plain_console(stderr=json_target == "-")
    console.print(_table(run.rig, document))
    console.print(f"kept in {path}", soft_wrap=True, markup=False, highlight=False)
    if json_target:
        write_json(document, json_target)


def document_of(run: Run) -> dict[str, Any]:
    """Keys: axes (hil.events.baseline), and steady: RMS error of the steady window by axis, m (rad)."""
    period_s = run.rig.period_ns * 1e-9
    models = axis_models(run.rig.model_dump(include={"axes"})["axes"])
    steady = {name: row["rms_error"] for name, row in run.summary()["axes"].items() if np.isfinite(row["rms_error"])}
    return {"axes": baseline_of(_unfollowed_as_zero(run), run.axes, models, period_s), "steady": steady}


def losses(run: Run, baseline: dict[str, Any]) -> list[Loss]:
    """Where a run is beyond a baseline; `at` is a place in its ticks."""
    models = axis_models(run.rig.model_dump(include={"axes"})["axes"])
    known = [known_of(baseline["axes"].get(name, {})) for name in run.axes]
    return AccuracyWatch(models, run.rig.period_ns, known).take(_unfollowed_as_zero(run))


def lines(run: Run, found: list[Loss]) -> list[str]:
    """For people: time, axis, signature, what was measured."""
    said = []
    for loss in found:
        axis, rotary = run.axes[loss.axis], run.rig.axes[run.axes[loss.axis]].kind == "rotary"
        unit = ROTARY.get(loss.unit, loss.unit) if rotary else loss.unit
        figures = f"{loss.value:.3g} {unit}, limit {loss.limit:.3g} {unit}"
        said.append(f"{run.time[loss.at]:.3f} s: {loss.signature} on {axis}: {loss.measured} {figures}")
    return said


def _unfollowed_as_zero(run: Run) -> dict[Any, Any]:
    """The columns, without the NaN of ticks in which nothing was followed: no window has those."""
    return {name: np.nan_to_num(values) if values.dtype.kind == "f" else values for name, values in run.columns.items()}


def _check(named: Path, run: Run, json_target: str) -> None:
    """Raises RecordingError where there is no baseline."""
    kept = read_baseline(run.rig)
    if kept is None:
        raise RecordingError(f"no baseline of this rig and task ({baseline_path(run.rig)}); keep one: hil baseline RUN")
    told = lines(run, losses(run, kept))
    if json_target:
        write_json({"run": str(named), "baseline": kept["run"], "beyond": told}, json_target)
    else:
        print("\n".join(told) or f"as the baseline, {kept['run']}")
    if told:
        raise typer.Exit(1)


def _table(rig: RigConfig, document: dict[str, Any]) -> Table:
    table = Table("axis", "phase", "windows", "RMS error", "most", "innovation", "new counts", "force")
    for name, phases in document["axes"].items():
        kind = rig.axes[name].kind
        for phase, row in phases.items():
            force = f"{row['force'][0]:.3g} {'N' if kind == 'linear' else 'N m'}"
            lengths = [metres(value, kind) for value in (*row["rms"], row["innovation"][0])]
            table.add_row(name, phase, str(row["windows"]), *lengths, f"{row['counts'][0]:.0%}", force)
    return table
