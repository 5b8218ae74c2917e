"""The search for a law's gains, one axis after the other (axes do not interact), and writing them into the rig file.

The optimiser is scipy's differential evolution on the candidates' cost by hil/studies/tune/objective.py. It starts from
the middle of the knobs' ranges or from the rig file's gains: the same rig, seed and options give the same gains.
"""

from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit

from hil.cli.output import replace_text
from hil.control.laws.base import Array
from hil.control.stability import check_stability
from hil.rig.schema import RigConfig, RigError
from hil.studies.tune.candidate_simulation import LOST
from hil.studies.tune.objective import Bench, Margins, Outcome, margins_of, trials

DIGITS = 4
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
    *, report: Callable[[Outcome], None], only: Sequence[str] = (), repeats: int = 1,
) -> Found:  # fmt: skip
    """Search one axis' gains; size: candidates per generation, generations; only: of these knobs, all if empty;
    repeats: of the trials.
    """
    wanted = Margins(*(value + slack if value else 0.0 for value, slack in zip(least, SLACK, strict=True)))
    bench = Bench(rig, law, axis, trials(rig, repeats), wanted, only)
    best, met = search(bench, *size, seed, report, start)
    return Found(bench.run(np.stack([bench.known(), best])), met, bench.gains(best[None]))


class AxisSearch(NamedTuple):
    """One axis' search as it travels: the rig as JSON, and the arguments of tune_axis."""

    rig: str
    law: str
    axis: int
    size: tuple[int, int]
    seed: int
    least: Margins
    start: str
    only: tuple[str, ...]
    repeats: int


def run_search(job: AxisSearch) -> Found:
    """As tune_axis, on whatever machine this is."""
    rig = RigConfig.model_validate_json(job.rig)
    return tune_axis(
        rig, job.law, job.axis, job.size, job.seed, job.least, Start(job.start),
        report=lambda outcome: None, only=job.only, repeats=job.repeats,
    )  # fmt: skip


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
