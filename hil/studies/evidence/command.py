"""The command: draws, runs and prints."""

import time
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
import typer

from hil.cli.options import JsonTarget, Overrides, ReadRig, named_axes
from hil.cli.output import write_json
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig
from hil.studies.crew import crew, resumed
from hil.studies.evidence.rows import CONFIDENCE, pooled
from hil.studies.evidence.stages import head
from hil.studies.evidence.stages import overrides as made_with
from hil.studies.evidence.trials import LEARNING_REPEATS, TRIALS, WARM_REPEATS, jobs, run


def evidence(
    rig_file: ReadRig,
    *,
    stages: Annotated[int, typer.Option(min=2, max=10_000, help="stages drawn for each row, of each seed")] = 20,
    seed: Annotated[str, typer.Option(help="of the stages; several, comma-separated, are pooled")] = "1",
    modes: Annotated[str, typer.Option(help="comma-separated, Hz of the free axis; 0: rigid")] = "0,150,200,300",
    axes: Annotated[str, typer.Option(help="comma-separated; default: all of the rig's")] = "",
    trials: Annotated[str, typer.Option(help="those whose names contain one of these, comma-separated")] = "",
    law: Annotated[str, typer.Option(help="default: the rig's own")] = "",
    hard: Annotated[
        bool,
        typer.Option(
            "--hard",
            help="stages with Stribeck and Maxwell-slip friction, rolling elements that pass, resonances that no model "
            "has, encoder errors, latency",
        ),
    ] = False,
    measured: Annotated[
        bool,
        typer.Option(
            "--measured", help="lag, mode and presliding of the rig file, within axes.NAME.measured; no --modes"
        ),
    ] = False,
    learning: Annotated[bool, typer.Option(help="with law.iterative_learning, after 16 repeats")] = False,
    overrides: Overrides = None,
    workers: Annotated[int, typer.Option(min=0, help="processes; 0: one per core")] = 0,
    json_target: JsonTarget = "",
) -> None:
    """Median and 95 % of a law's accuracies over drawn stages with presliding, lag, mode and noise."""
    from hil.cli.console import plain_console

    begun = time.monotonic()
    # The rig's own task may be one that does not repeat: what is tried are this command's.
    sets = [*(overrides or ()), *([f"law.name={law}"] if law else ()), "law.iterative_learning=false"]
    rig = load_rig(rig_file, sets)
    rig = rig.model_copy(update={"law": rig.law.model_copy(update={"iterative_learning": learning})})
    named = named_axes(axes, rig.axis_names)
    names = [name for name in rig.axis_names if name in named]
    wanted = [part.strip() for part in trials.split(",") if part.strip()]
    seeds, drawn_modes = _seeds(seed), [None] if measured else _modes(modes)
    work = [
        job
        for one in seeds
        for job in jobs(rig, names, stages, one, drawn_modes, hard=hard)
        if not wanted or any(part in job.trial.name for part in wanted)
    ]
    if not work:
        raise typer.BadParameter(f"--trials {trials}: they are {'; '.join(trial.name for trial in TRIALS)}")
    console = plain_console(stderr=json_target == "-")
    with crew(workers) as hands:
        found = list(resumed(hands, run, work))
    rows = pooled(names, work, found)
    of = (
        f"median / 95 % of {stages * len(seeds)} {'hard ' if hard else ''}stages (seed and number of the worst), "
        f"below their {100 * CONFIDENCE:.0f} % intervals; seed {', '.join(map(str, seeds))}"
    )
    _show(console, rig, names, rows, of, head(hard=hard))
    plain_console(stderr=True).print(f"{time.monotonic() - begun:.0f} s")  # no result: it differs each time
    if json_target:
        asked = {"learning": learning, "stages": stages, "seeds": seeds, "hard": hard, "measured": measured}
        document = {"rig": rig.name, "law": rig.law.name, **asked}
        drawn = [
            {"mode_hz": mode_hz, "seed": one, "stage": number, "set": made_with(rig, one, number, mode_hz, hard=hard)}
            for mode_hz in dict.fromkeys(job.mode_hz for job in work)
            for one in seeds
            for number in range(stages)
        ]
        write_json({**document, "of": head(hard=hard), "rows": rows, "drawn": drawn}, json_target)


def _modes(modes: str) -> list[float | None]:
    try:
        found = [float(value) for value in modes.split(",")]
    except ValueError:
        found = [-1.0]
    if any(value != 0.0 and not 1.0 <= value <= 5000.0 for value in found):
        raise typer.BadParameter(f"--modes {modes}: expected 0 or 1 to 5000 Hz each, separated by commas")
    return [*found]


def _seeds(seeds: str) -> list[int]:
    try:
        found = [int(value) for value in seeds.split(",")]
    except ValueError:
        found = [-1]
    if min(found) < 0 or len(set(found)) < len(found):
        raise typer.BadParameter(f"--seed {seeds}: expected different integers from 0, separated by commas")
    return found


def _unit(figure: str) -> tuple[str, float]:
    if "repeats" in figure:
        return "", 1.0
    return ("ms", 1e3) if figure.endswith("nm") else ("nm", 1e9)


def _within(interval: tuple[float, float], scale: float) -> str:
    low, high = interval
    return f"{_digits(low * scale)} to {_digits(high * scale)}" if np.isfinite(high) else f"from {_digits(low * scale)}"


def _digits(value: float) -> str:
    """Three of them: 0.123, 1470."""
    return f"{float(f'{value:.3g}'):g}"


def _show(
    console: Any, rig: RigConfig, names: Sequence[str], rows: Sequence[dict[str, Any]], of: str, foot: str
) -> None:
    from rich.table import Table

    learning = f", {WARM_REPEATS} repeats and {LEARNING_REPEATS} that learn" if rig.law.iterative_learning else ""
    title = f"{rig.name}, {rig.law.name}{learning}, at {rig.rate_hz:g} Hz: {of}"
    table = Table(title=title, caption=foot)
    table.add_column("mode")
    table.add_column("figure")
    for name in names:
        table.add_column(name, justify="right")
    for row in rows:
        unit, scale = _unit(row["figure"])
        cells = []
        for axis in row["axes"].values():
            failed = f" ({axis['failed']} failed)" if axis["failed"] else ""
            figures = f"{_digits(axis['median'] * scale)} / {_digits(axis['p95'] * scale)}"
            within = " / ".join(_within(axis[f"{name}_interval"], scale) for name in ("median", "p95"))
            cells.append(f"{figures} ({'-'.join(map(str, axis['worst']))}){failed}\n{within}")
        mode = "as measured" if row["mode_hz"] is None else f"{row['mode_hz']:g} Hz" if row["mode_hz"] else "rigid"
        table.add_row(mode, f"{row['figure']}{', ' if unit else ''}{unit}", *cells)
    console.print(table)
