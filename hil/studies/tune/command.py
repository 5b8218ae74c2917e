"""`hil tune`: gains for a law under the rig's own delay, rate, encoder, filter and limits, over tasks and corners."""

import shlex
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from hil.cli.options import Overrides, RigFile, Scheduler
from hil.cli.output import metres, print_plant_notes
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.studies.crew import crew, resumed
from hil.studies.tune.objective import Margins, Outcome
from hil.studies.tune.search import (
    AxisSearch,
    Found,
    Start,
    front,
    refuse_short_margins,
    rounded,
    run_search,
    tune_axis,
    write_gains,
)
from hil.studies.tune.search_space import law_gains, space_of
from hil.virtual.sim import usable

WIDTH = 120  # characters of a table that goes to a file


def tune(
    rig_file: RigFile,
    *,
    law: Annotated[str, typer.Option(help="law to tune; default: the rig's own")] = "",
    overrides: Overrides = None,
    population: Annotated[int, typer.Option(min=5, max=1000, help="candidates per generation")] = 40,
    generations: Annotated[int, typer.Option(min=1, max=1000, help="generations per axis")] = 30,
    seed: Annotated[int, typer.Option(min=0, help="of the search")] = 1,
    margin: Annotated[float, typer.Option(min=0.0, max=20.0, help="least gain margin, dB")] = 6.0,
    phase_margin: Annotated[float, typer.Option(min=0.0, max=80.0, help="least phase margin, degrees")] = 30.0,
    only: Annotated[
        str, typer.Option(help="knobs to search, comma-separated; the others stay as the file has them")
    ] = "",
    repeats: Annotated[
        int, typer.Option(min=1, max=10, help="of every trial, in sizes a little apart: luck counts less")
    ] = 1,
    start: Annotated[Start, typer.Option(help="where to begin: mid-range, or the rig file's gains")] = Start.MIDDLE,
    scheduler: Scheduler = "",
    dry_run: Annotated[bool, typer.Option(help="do not write the rig file")] = False,
) -> None:
    """Find gains for a law on a set of tasks and plants, show the trade, and write them to the rig file.

    The same rig, seed and options give the same gains; the command is written beside them.
    """
    from rich.console import Console
    from rich.progress import Progress

    rig = load_rig(rig_file, overrides or ())
    name = law or rig.law.name
    rig = usable(load_rig(rig_file, [*(overrides or ()), f"law.name={name}"]), rig_file)
    if not space_of(rig, name):
        raise RigError([f"--law {name}: the law declares no gain with a range to search (hil.Knob)"])
    console = Console()
    if not console.is_terminal:
        console.width = WIDTH
    print_plant_notes(console, rig)
    chosen = [key.strip() for key in only.split(",") if key.strip()]
    for key in chosen:
        if key not in space_of(rig, name):
            raise RigError([f"--only {key}: {name} has {', '.join(space_of(rig, name))}"])
    least = Margins(margin, phase_margin)
    found = []
    with Progress(console=console, transient=True) as bar:
        job = bar.add_task(f"{rig.name}: {name}", total=(generations + 1) * len(rig.axes))
        if scheduler:
            size, document = (population, generations), rig.model_dump_json()
            work = [
                AxisSearch(document, name, axis, size, seed, least, start.value, tuple(chosen), repeats)
                for axis in range(len(rig.axes))
            ]
            with crew(0, scheduler) as hands:
                for axis_found in resumed(hands, run_search, work):
                    found.append(axis_found)
                    bar.update(job, advance=generations + 1)
        for axis, axis_name in enumerate([] if scheduler else rig.axis_names):

            def report(outcome: Outcome, axis_name: str = axis_name) -> None:
                note = f"{name}, {axis_name}: {outcome.ratio[outcome.cost.argmin()]:.3g} times what is good"
                bar.update(job, advance=1, description=note)

            found.append(
                tune_axis(
                    rig,
                    name,
                    axis,
                    (population, generations),
                    seed,
                    least,
                    start,
                    report=report,
                    only=chosen,
                    repeats=repeats,
                )
            )
    gains = {**law_gains(rig, name), **rounded([axis.gains for axis in found])}
    _show(console, rig, found)
    for key, values in gains.items():
        console.print(f"{key} = {values}", markup=False)
    tuned = rig.law.model_copy(update={"name": name, "gains": {}, "tuned": {name: gains}})
    refuse_short_margins(rig.model_copy(update={"law": tuned}), least)
    if not dry_run:
        options = {"--law": name, "--population": population, "--generations": generations, "--seed": seed}
        options |= {"--margin": f"{margin:g}", "--phase-margin": f"{phase_margin:g}", "--start": start.value}
        options |= {"--repeats": repeats} if repeats > 1 else {}
        options |= {"--only": ",".join(chosen)} if chosen else {}
        words = [word for key, value in options.items() for word in (key, str(value))]
        words += [word for text in overrides or () for word in ("--set", text)]
        write_gains(rig_file, name, gains, [shlex.join(["hil", "tune", str(rig_file), *words]), _achieved(rig, found)])
        console.print(f"written to {rig_file}: [law.tuned.{name}]", markup=False)


def _achieved(rig: RigConfig, found: Sequence[Found]) -> str:
    parts = [
        f"{name} {metres(float(error), rig.axes[name].kind)}, {gain_db:.1f} dB, {phase_deg:.0f} deg"
        for name, axis in zip(rig.axis_names, found, strict=True)
        for error, _, _, gain_db, phase_deg, _ in [[values[1] for values in axis.outcome]]
    ]
    return f"error in the worst trial, gain and phase margin: {'; '.join(parts)}"


def _show(console: Any, rig: RigConfig, found: Sequence[Found]) -> None:
    from rich.table import Table

    title = "worst trial with the rig file's gains -> with those found; the trade below"
    table = Table("axis", "error", "of what is good", "chatter", "gain margin", "phase margin", title=title)
    for name, (outcome, _, _) in zip(rig.axis_names, found, strict=True):
        errors = (metres(float(error), rig.axes[name].kind) for error in outcome.error)
        pairs = ((f"{before:.3g}", f"{after:.3g}") for before, after, *_ in outcome[1:5])
        table.add_row(name, *(" -> ".join(pair) for pair in (errors, *pairs)))
    console.print(table)
    for name, (_, met, _) in zip(rig.axis_names, found, strict=True):
        kind = rig.axes[name].kind
        for column, sign, unit in ((1, 1.0, "chatter per tick"), (2, -1.0, "dB of gain margin")):
            trade = front(met[:, [0, column]] * [1.0, sign])
            picked = trade[:: max(len(trade) // 6, 1)][:7]
            shown = "; ".join(f"{metres(error, kind)} at {sign * price:.3g}" for error, price in picked)
            console.print(f"trade on {name}, error in the worst trial at {unit}: {shown}")
