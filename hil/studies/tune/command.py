"""`hil tune`: gains for a law under the rig's own delay, rate, encoder, filter and limits, over tasks and corners."""

import itertools
import shlex
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import typer

from hil.cli.options import Overrides, RigFile, Scheduler
from hil.cli.output import print_plant_notes
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.studies.crew import crew, resumed
from hil.studies.tune.objective import Kind, Margins, Outcome, kind_for
from hil.studies.tune.report import achieved, announced, show
from hil.studies.tune.search import (
    UNSEEN,
    AxisSearch,
    Choice,
    Found,
    Start,
    all_or_none,
    refuse_short_margins,
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
    seed: Annotated[int, typer.Option(min=0, help="seed of the search")] = 1,
    margin: Annotated[float, typer.Option(min=0.0, max=20.0, help="least gain margin, dB")] = 6.0,
    phase_margin: Annotated[float, typer.Option(min=0.0, max=80.0, help="least phase margin, degrees")] = 30.0,
    only: Annotated[
        str, typer.Option(help="knobs to search, comma-separated; the others stay as the file has them")
    ] = "",
    repeats: Annotated[
        int, typer.Option(min=1, max=10, help="of every trial, each a little smaller, so that luck counts less")
    ] = 1,
    trials: Annotated[
        Kind | None,
        typer.Option(
            help="task: the rig's task in several sizes and speeds; ideal: also pushes, cogging, Stribeck friction and "
            "small moves; stage: also presliding, lag and resonance, at ten times the cost; default: stage where "
            "the rig states any of these"
        ),
    ] = None,
    unseen: Annotated[
        int,
        typer.Option(min=1, max=1000, help="drawn plants, not used in the search, that the new gains are judged on"),
    ] = UNSEEN,
    start: Annotated[
        Start, typer.Option(help="begin in the middle of the ranges, or at the rig file's gains")
    ] = Start.MIDDLE,
    scheduler: Scheduler = "",
    dry_run: Annotated[bool, typer.Option(help="do not write the rig file")] = False,
) -> None:
    """Find gains for a law on a set of tasks and plants, show the trade, and write what is better to the rig file.

    The same rig, seed and options give the same gains; the command is written beside them. An axis keeps the file's
    gains unless those found are better on plants that were not searched, too.
    """
    from hil.cli.console import plain_console
    from hil.cli.progress import Steps

    rig = load_rig(rig_file, overrides or ())
    name = law or rig.law.name
    rig = usable(load_rig(rig_file, [*(overrides or ()), f"law.name={name}"]), rig_file)
    if not space_of(rig, name):
        raise RigError([f"--law {name}: the law declares no gain with a range to search (hil.Knob)"])
    console = plain_console()
    if not console.is_terminal:
        console.width = WIDTH
    print_plant_notes(console, rig)
    chosen = [key.strip() for key in only.split(",") if key.strip()]
    for key in chosen:
        if key not in space_of(rig, name):
            raise RigError([f"--only {key}: {name} has {', '.join(space_of(rig, name))}"])
    least = Margins(margin, phase_margin)
    kind = trials or kind_for(rig)
    choice = Choice((population, generations), seed, least, start, chosen, repeats, kind, unseen)
    found: list[Found] = []
    console.print(announced(rig, name, choice), markup=False, highlight=False, soft_wrap=True)
    with Steps(f"{rig.name}: {name}", (generations + 1) * len(rig.axes)) as steps:
        if scheduler:
            document = rig.model_dump_json()
            work = [AxisSearch(document, name, axis, choice) for axis in range(len(rig.axes))]
            with crew(0, scheduler) as hands:
                for axis_found in resumed(hands, run_search, work):
                    found.append(axis_found)
                    steps.advance(generations + 1)
        for axis, axis_name in enumerate([] if scheduler else rig.axis_names):
            generation = itertools.count()

            def report(outcome: Outcome, axis_name: str = axis_name, number: Iterator[int] = generation) -> None:
                best = outcome.ratio[outcome.cost.argmin()]
                step = f"generation {now} of {generations}" if (now := next(number)) else "first draw"
                steps.advance(text=f"{name}, {axis_name}, {step}: best cost {best:.3g} (target 1.0)")

            found.append(tune_axis(rig, name, axis, choice, report))
    found = all_or_none(found)
    show(console, rig, found)
    gains = _gains_to_write(rig, name, found)
    for key, values in gains.items():
        console.print(f"{key} = {values}", markup=False)
    if all(axis.kept for axis in found):
        console.print(f"No better gains found; {rig_file} is unchanged", markup=False)
        return
    tuned = rig.law.model_copy(update={"name": name, "gains": {}, "tuned": {name: gains}})
    refuse_short_margins(rig.model_copy(update={"law": tuned}), least)
    if not dry_run:
        options = {"--law": name, "--population": population, "--generations": generations, "--seed": seed}
        options |= {"--margin": f"{margin:g}", "--phase-margin": f"{phase_margin:g}", "--trials": kind.value}
        options |= {"--start": start.value}
        options |= {"--unseen": unseen} if unseen != UNSEEN else {}
        options |= {"--repeats": repeats} if repeats > 1 else {}
        options |= {"--only": ",".join(chosen)} if chosen else {}
        words = [word for key, value in options.items() for word in (key, str(value))]
        words += [word for text in overrides or () for word in ("--set", text)]
        write_gains(rig_file, name, gains, [shlex.join(["hil", "tune", str(rig_file), *words]), achieved(rig, found)])
        console.print(f"written to {rig_file}: [law.tuned.{name}]", markup=False)


def _gains_to_write(rig: RigConfig, law: str, found: Sequence[Found]) -> dict[str, Any]:
    """Of all axes: those found, and the file's own where an axis keeps them."""
    known = law_gains(rig, law)
    if all(axis.kept for axis in found):
        return known
    return {**known, **{key: [float(axis.gains[key][0]) for axis in found] for key in found[0].gains}}
