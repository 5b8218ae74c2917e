"""`hil tune`: gains for a law under the rig's own delay, rate, encoder, filter and limits, over tasks and corners."""

import itertools
import shlex
import time
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import typer

from hil.cli.options import Overrides, RigFile, Scheduler, named_axes
from hil.cli.output import print_plant_notes
from hil.control.estimator.gains import per_axis
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.studies.crew import crew, resumed
from hil.studies.tune import drawn_report, report
from hil.studies.tune.drawn_search import DrawnFound
from hil.studies.tune.drawn_stages import FRESH
from hil.studies.tune.objective import ANY, Kind, Margins, Outcome, kind_for
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
from hil.studies.tune.search_space import law_gains, own_gains, space_of
from hil.virtual.sim import usable

WIDTH = 120  # characters of a table that goes to a file
GENERATIONS, DRAWN_GENERATIONS = 30, 4
LEAST = Margins(6.0, 30.0)


def tune(
    rig_file: RigFile,
    *,
    law: Annotated[str, typer.Option(help="law to tune; default: the rig's own")] = "",
    overrides: Overrides = None,
    axes: Annotated[str, typer.Option(help="comma-separated, the others keep theirs; default: all of the rig's")] = "",
    population: Annotated[int, typer.Option(min=5, max=1000, help="candidates per generation")] = 40,
    generations: Annotated[
        int | None, typer.Option(min=1, max=1000, help="generations per axis; default: 30, on drawn stages 4")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="seed of the search")] = 1,
    margin: Annotated[
        float | None,
        typer.Option(min=0.0, max=20.0, help="least gain margin, dB; default: 6, on drawn stages hil check's"),
    ] = None,
    phase_margin: Annotated[
        float | None,
        typer.Option(min=0.0, max=80.0, help="least phase margin, degrees; default: 30, on drawn stages hil check's"),
    ] = None,
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
            "small moves; stage: also presliding, lag and resonance, at ten times the cost; drawn: the rig's task on "
            "stages as hil evidence --measured draws them; default: drawn for presliding-kalman, else stage where the "
            "rig states any of these"
        ),
    ] = None,
    unseen: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=1000,
            help="drawn plants, not used in the search, that the new gains are judged on; default: 12, drawn stages 60",
        ),
    ] = None,
    start: Annotated[
        Start | None,
        typer.Option(
            help="begin in the middle of the ranges, or at the rig file's gains; default: middle, on drawn stages rig"
        ),
    ] = None,
    scheduler: Scheduler = "",
    dry_run: Annotated[bool, typer.Option(help="do not write the rig file")] = False,
) -> None:
    """Find gains for a law on a set of tasks and plants, show the trade, and write what is better to the rig file.

    The same rig, seed and options give the same gains; the command is written beside them. An axis keeps the file's
    gains unless those found are better on plants that were not searched, too.
    """
    from hil.cli.console import plain_console
    from hil.cli.progress import Steps

    begun = time.monotonic()
    rig = load_rig(rig_file, overrides or ())
    name = law or rig.law.name
    rig = usable(load_rig(rig_file, [*(overrides or ()), f"law.name={name}"]), rig_file)
    console = plain_console()
    if not console.is_terminal:
        console.width = WIDTH
    print_plant_notes(console, rig)
    chosen = _knobs(rig, name, only)
    wanted = named_axes(axes, rig.axis_names)
    names = [axis_name for axis_name in rig.axis_names if axis_name in wanted]
    if len(names) < len(rig.axes):
        _refuse_unknown(rig, name, chosen)
    kind = trials or kind_for(rig, name)
    choice = _choice(
        kind, (population, generations), (margin, phase_margin),
        seed=seed, start=start, only=chosen, repeats=repeats, unseen=unseen,
    )  # fmt: skip
    found: list[Found | DrawnFound] = []
    way: Any = drawn_report if choice.trials is Kind.DRAWN else report
    console.print(way.announced(rig, name, choice, names), markup=False, highlight=False, soft_wrap=True)
    with Steps(f"{rig.name}: {name}", (choice.size[1] + 1) * len(names)) as steps:
        if scheduler:
            document = rig.model_dump_json()
            work = [AxisSearch(document, name, rig.axis_names.index(axis_name), choice) for axis_name in names]
            with crew(0, scheduler) as hands:
                for axis_found in resumed(hands, run_search, work):
                    found.append(axis_found)
                    steps.advance(choice.size[1] + 1)
        for axis_name in [] if scheduler else names:
            generation = itertools.count()

            def tell(outcome: Outcome, axis_name: str = axis_name, number: Iterator[int] = generation) -> None:
                best = outcome.ratio[outcome.cost.argmin()]
                step = f"generation {now} of {choice.size[1]}" if (now := next(number)) else "first draw"
                steps.advance(text=f"{name}, {axis_name}, {step}: best cost {best:.3g} ({way.AIM})")

            found.append(tune_axis(rig, name, rig.axis_names.index(axis_name), choice, tell))
    found = all_or_none(found)
    way.show(console, rig, names, found)
    gains = _gains_to_write(rig, name, names, found)
    for key, values in gains.items():
        console.print(f"{key} = {values}", markup=False)
    plain_console(stderr=True).print(f"{time.monotonic() - begun:.0f} s")  # no result: it differs each time
    if all(axis.kept for axis in found):
        console.print(f"No better gains found; {rig_file} is unchanged", markup=False)
        return
    tuned = rig.law.model_copy(update={"name": name, "gains": {}, "tuned": {name: gains}})
    refuse_short_margins(rig.model_copy(update={"law": tuned}), choice.least)
    if not dry_run:
        words = [str(rig_file), "--law", name, *_options(choice), *(["--axes", ",".join(names)] if axes else [])]
        words += [word for text in overrides or () for word in ("--set", text)]
        write_gains(rig_file, name, gains, [shlex.join(["hil", "tune", *words]), way.achieved(rig, names, found)])
        told = f"written to {rig_file}: [law.tuned.{name}]; next: hil check {shlex.quote(str(rig_file))}"
        console.print(told, markup=False, soft_wrap=True)


def _choice(
    trials: Kind, size: tuple[int, int | None], margins: tuple[float | None, float | None],
    *, seed: int, start: Start | None, only: Sequence[str], repeats: int, unseen: int | None,
) -> Choice:  # fmt: skip
    """With the defaults of what was not given (None). Raises RigError for options that say nothing on drawn stages."""
    population, generations = size
    if trials is Kind.DRAWN:
        given = dict(zip(("--margin", "--phase-margin", "--start"), (*margins, start), strict=True))
        given["--repeats"] = repeats if repeats > 1 else None
        if named := [key for key, value in given.items() if value is not None]:
            raise RigError([f"{', '.join(named)}: not with --trials drawn, whose margins and start are the rig's own"])
        whole = population, generations or DRAWN_GENERATIONS
        return Choice(whole, seed, ANY, Start.RIG, only, 1, trials, unseen or FRESH)
    least = Margins(*(usual if value is None else value for value, usual in zip(margins, LEAST, strict=True)))
    whole = population, generations or GENERATIONS
    return Choice(whole, seed, least, start or Start.MIDDLE, only, repeats, trials, unseen or UNSEEN)


def _options(choice: Choice) -> list[str]:
    """Of the command line that gives the same gains again."""
    drawn = choice.trials is Kind.DRAWN
    options: dict[str, Any] = {"--population": choice.size[0], "--generations": choice.size[1], "--seed": choice.seed}
    least = {} if drawn else {"--margin": choice.least.gain_db, "--phase-margin": choice.least.phase_deg}
    options |= {key: f"{value:g}" for key, value in least.items()}
    options |= {"--trials": choice.trials.value} | ({} if drawn else {"--start": choice.start.value})
    options |= {"--unseen": choice.unseen} if choice.unseen != (FRESH if drawn else UNSEEN) else {}
    options |= {"--repeats": choice.repeats} if choice.repeats > 1 else {}
    options |= {"--only": ",".join(choice.only)} if choice.only else {}
    return [word for key, value in options.items() for word in (key, str(value))]


def _knobs(rig: RigConfig, law: str, only: str) -> list[str]:
    """Those that --only names. Raises RigError where the law lacks one, or has none at all."""
    space, chosen = space_of(rig, law), [key.strip() for key in only.split(",") if key.strip()]
    if not space:
        raise RigError([f"--law {law}: the law declares no gain with a range to search (hil.Knob)"])
    if unknown := [key for key in chosen if key not in space]:
        raise RigError([f"--only {unknown[0]}: {law} has {', '.join(space)}"])
    return chosen


def _refuse_unknown(rig: RigConfig, law: str, chosen: Sequence[str]) -> None:
    """Raises RigError where axes that keep their gains have none."""
    known = own_gains(rig, law).keys() | law_gains(rig, law).keys()
    if lacking := [key for key in space_of(rig, law) if key not in known and (not chosen or key in chosen)]:
        raise RigError([f"--axes: the rig file states no {', '.join(lacking)} of {law} for the others; leave it out"])


def _gains_to_write(
    rig: RigConfig, law: str, names: Sequence[str], found: Sequence[Found | DrawnFound]
) -> dict[str, Any]:
    """Of all axes: those found, and the rig's own where an axis keeps them."""
    known = law_gains(rig, law)
    if all(axis.kept for axis in found):
        return known
    given = {**{key: values.tolist() for key, values in own_gains(rig, law).items()}, **known}
    by_axis = dict(zip(names, found, strict=True))
    for key in found[0].gains:
        before = per_axis(given[key], len(rig.axes)) if key in given else [0.0] * len(rig.axes)
        known[key] = [
            float(by_axis[name].gains[key][0] if name in by_axis else before[i])
            for i, name in enumerate(rig.axis_names)
        ]
    return known
