"""`hil tune`: gains for a law under the rig's own delay, rate, encoder, filter and limits, over tasks and corners.

The optimiser is scipy's differential evolution, one axis after the other (axes do not interact), on the candidates'
price by hil/studies/tune/objective.py. It starts from the middle of the knobs' ranges, whatever gains the rig file has:
the same rig, seed and options give the same gains, and the command is written beside them.
"""

import shlex
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import tomlkit
import typer

from hil.cli.output import metres, replace_text
from hil.control.laws.base import Array
from hil.control.stability import check_stability
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.studies.tune.candidate_simulation import LOST
from hil.studies.tune.objective import Bench, Margins, Outcome, margins_of, trials
from hil.studies.tune.search_space import law_gains, space_of
from hil.virtual.lockstep import usable

DIGITS = 4
WIDTH = 120  # characters of a table that goes to a file
SLACK = Margins(0.05, 0.3)  # beyond the margins asked for: the gains are rounded to DIGITS


class Start(StrEnum):
    """Where a search begins: in the middle of every knob's range, or at the rig file's gains."""

    MIDDLE = "middle"
    RIG = "rig"


def first_generation(bench: Bench, population: int, start: Start, rng: np.random.Generator) -> Array:
    """Points (population, knobs): all over the ranges, or most of them around the rig's gains, and the start itself."""
    knobs = len(bench.space)
    points = rng.random((population, knobs))
    if start is Start.RIG:
        near = 3 * population // 4
        points[:near] = np.clip(bench.known() + 0.1 * rng.standard_normal((near, knobs)), 0.0, 1.0)
    points[0] = bench.known() if start is Start.RIG else 0.5
    return points


def search(
    bench: Bench, population: int, generations: int, seed: int, report: Callable[[Outcome], None],
    start: Start = Start.RIG,
) -> tuple[Array, Array]:  # fmt: skip
    """Differential evolution: best point (knobs,); error, chatter, gain margin of all stable candidates, (met, 3)."""
    from scipy.optimize import differential_evolution

    met: list[Array] = []
    rng = np.random.default_rng([seed, bench.axis])

    def cost(candidates: Array) -> Array:
        outcome = bench.run(candidates.T)
        sound = outcome.gain_db >= 0.0
        met.append(np.stack([outcome.error, outcome.chatter, outcome.gain_db], axis=1)[sound])
        report(outcome)
        return outcome.cost

    result = differential_evolution(
        cost, [(0.0, 1.0)] * len(bench.space), maxiter=generations,
        init=first_generation(bench, population, start, rng), vectorized=True, updating="deferred", polish=False,
        rng=rng, mutation=(0.3, 0.8), recombination=0.9, tol=1e-6,
    )  # fmt: skip
    return result.x, np.concatenate(met)


def rounded(axes: Sequence[Mapping[str, Array]]) -> dict[str, list[float]]:
    """Gains of one candidate for every axis, with DIGITS significant digits."""
    return {name: [float(f"{float(gains[name][0]):.{DIGITS}g}") for gains in axes] for name in axes[0]}


def write_gains(path: Path, law: str, gains: Mapping[str, Any], notes: Sequence[str]) -> None:
    """Put [law.tuned.<law>] into the rig file; everything else, comments included, stays as it is, but for values in
    [law.gains] that would hide what was found.
    """
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    section: Any = document.setdefault("law", tomlkit.table())
    if section.get("name", law) == law and "gains" in section:
        for name in gains:
            section["gains"].pop(name, None)
        if not section["gains"]:
            del section["gains"]
    if "tuned" not in section:
        section["tuned"] = tomlkit.table(is_super_table=True)
    table = tomlkit.table()
    for note in notes:
        table.add(tomlkit.comment(note))
    for name, values in gains.items():
        table.add(name, values)
    table.add(tomlkit.nl())
    section["tuned"][law] = table
    replace_text(path, tomlkit.dumps(document))


def front(met: Array) -> list[tuple[float, float]]:
    """The trade: (error, price) of the candidates (met, 2) that no other beats in both."""
    chosen: list[tuple[float, float]] = []
    for error, price in sorted(map(tuple, met.tolist())):
        if error < LOST and (not chosen or price < chosen[-1][1]):
            chosen.append((error, price))
    return chosen


class Found(NamedTuple):
    """One axis: what the rig file's gains (first) and the best ones (second) give; every stable candidate's error (m),
    chatter (N) and gain margin (dB), (met, 3).
    """

    outcome: Outcome
    met: Array
    gains: dict[str, Array]


def tune_axis(
    rig: RigConfig, law: str, axis: int, size: tuple[int, int], seed: int, least: Margins, start: Start,
    report: Callable[[Outcome], None], only: Sequence[str] = (), repeats: int = 1,
) -> Found:  # fmt: skip
    """Search one axis' gains; size: candidates per generation, generations; only: of these knobs, all if empty;
    repeats: of the trials.
    """
    wanted = Margins(*(value + slack if value else 0.0 for value, slack in zip(least, SLACK, strict=True)))
    bench = Bench(rig, law, axis, trials(rig, repeats), wanted, only)
    best, met = search(bench, *size, seed, report, start)
    return Found(bench.run(np.stack([bench.known(), best])), met, bench.gains(best[None]))


def refuse_short_margins(rig: RigConfig, least: Margins) -> None:
    """Raises RigError naming every axis whose loop is unstable, or whose margins are less than `least`."""
    report = check_stability(rig)
    lines = report.problems()
    for name, axis in report.axes.items():
        found = margins_of(axis)
        if axis.stable and found.short(least):
            lines.append(
                f"law '{rig.law.name}' on axis '{name}': margins of {found.gain_db:.1f} dB and {found.phase_deg:.0f} "
                f"deg, less than {least.gain_db:g} dB and {least.phase_deg:g} deg; nothing is written; more "
                "--generations, a lower --margin or --phase-margin would do"
            )
    if lines:
        raise RigError(lines)


def tune(
    rig_file: Annotated[Path, typer.Argument(metavar="RIG", help="rig file")],
    law: Annotated[str, typer.Option(help="law to tune; default: the rig's own")] = "",
    overrides: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="override a value")] = None,
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
    chosen = [key.strip() for key in only.split(",") if key.strip()]
    for key in chosen:
        if key not in space_of(rig, name):
            raise RigError([f"--only {key}: {name} has {', '.join(space_of(rig, name))}"])
    least = Margins(margin, phase_margin)
    found = []
    with Progress(console=console, transient=True) as bar:
        job = bar.add_task(f"{rig.name}: {name}", total=(generations + 1) * len(rig.axes))
        for axis, axis_name in enumerate(rig.axis_names):

            def report(outcome: Outcome, axis_name: str = axis_name) -> None:
                note = f"{name}, {axis_name}: {outcome.ratio[outcome.cost.argmin()]:.3g} times what is good"
                bar.update(job, advance=1, description=note)

            found.append(
                tune_axis(rig, name, axis, (population, generations), seed, least, start, report, chosen, repeats)
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
