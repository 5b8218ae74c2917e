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

from hil.analysis.stability import check_stability
from hil.cli.output import replace_text
from hil.control.laws.base import Array
from hil.rig.schema import RigConfig, RigError
from hil.studies.tune.candidate_simulation import LOST
from hil.studies.tune.drawn_search import DrawnFound, tune_drawn
from hil.studies.tune.objective import (
    DIGITS,
    SLACK,
    Bench,
    Kind,
    Margins,
    Outcome,
    margins_of,
    rounded_to,
    trials_of,
    unseen_trials,
)

UNSEEN = 12  # plants that no search has seen


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
    """Differential evolution: best point (knobs,); error, chatter, gain margin of all stable candidates, (met, 3).

    Raises ValueError for what a law raises in a trial, with file and line.
    """
    from scipy.optimize import differential_evolution

    met: list[Array] = []
    rng = np.random.default_rng([seed, bench.axis])

    def cost(candidates: Array) -> Array:
        outcome = bench.run(candidates.T)
        sound = outcome.gain_db >= 0.0
        met.append(np.stack([outcome.error, outcome.chatter, outcome.gain_db], axis=1)[sound])
        report(outcome)
        return outcome.cost

    try:
        result = differential_evolution(
            cost, [(0.0, 1.0)] * len(bench.space), maxiter=generations,
            init=first_generation(bench, population, start, rng), vectorized=True, updating="deferred", polish=False,
            rng=rng, mutation=(0.3, 0.8), recombination=0.9, tol=1e-6,
        )  # fmt: skip
    except RuntimeError as error:  # scipy's, of whatever a law raises in a trial
        raise error.__cause__ or error from None
    return result.x, np.concatenate(met)


def write_gains(path: Path, law: str, gains: Mapping[str, Any], notes: Sequence[str]) -> None:
    """Put [law.tuned.<law>] into the rig file; everything else, comments included, stays as it is, except values in
    [law.gains] that would hide what was found, and law.learnt, which was learnt with other gains.
    """
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    section: Any = document.setdefault("law", tomlkit.table())
    if section.get("name", law) == law:
        section.pop("learnt", None)
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


class Judged(NamedTuple):
    """What one candidate's gains give: in the trials of the search, and on plants that no search has seen."""

    searched: Outcome
    unseen: Outcome


class Found(NamedTuple):
    """One axis: the rig file's gains and the best ones of the search; every stable candidate's error (m), chatter (N)
    and gain margin (dB), (met, 3). Then the gains to have from now on, (1,) each, and whether they are the rig file's.
    """

    before: Judged
    best: Judged
    met: Array
    gains: dict[str, Array]
    kept: bool

    @property
    def now(self) -> Judged:
        """Of the gains to have."""
        return self.before if self.kept else self.best


def is_better(new: Judged, old: Judged, least: Margins) -> bool:
    """Whether new gains should replace those there are, one candidate each: with the margins asked for where the old
    ones have not. Else of less cost on plants that no search has seen, where the worst must not be worse, nor in the
    trials of the search.
    """
    lacking = [Margins(float(each.gain_db[0]), float(each.phase_deg[0])).short(least) for each in (new[0], old[0])]
    if (lacking[0] > 0.0) != (lacking[1] > 0.0):
        return lacking[1] > 0.0
    not_worse = all(one.ratio[0] <= other.ratio[0] for one, other in zip(new, old, strict=True))
    return bool(not_worse and new.unseen.cost[0] < old.unseen.cost[0])


class Choice(NamedTuple):
    """What to search, and on what. size: candidates per generation, and generations. only: these knobs, all if empty.
    unseen: plants to judge by at the end. On drawn stages `least`, `start` and `repeats` say nothing.
    """

    size: tuple[int, int]
    seed: int
    least: Margins
    start: Start
    only: Sequence[str] = ()
    repeats: int = 1
    trials: Kind = Kind.IDEAL
    unseen: int = UNSEEN


def tune_axis(
    rig: RigConfig, law: str, axis: int, choice: Choice, report: Callable[[Outcome], None]
) -> Found | DrawnFound:
    """Search one axis' gains, and hold what is found against the rig file's own."""
    if choice.trials is Kind.DRAWN:
        return tune_drawn(rig, law, axis, choice.size, choice.seed, report, only=choice.only, fresh=choice.unseen)
    least = choice.least
    wanted = Margins(*(value + slack if value else 0.0 for value, slack in zip(least, SLACK, strict=True)))
    chosen = trials_of(rig, axis, choice.trials, choice.repeats)
    bench = Bench(rig, law, axis, chosen, wanted, choice.only)
    best, met = search(bench, *choice.size, choice.seed, report, choice.start)
    found = {name: np.array([rounded_to(DIGITS, value)]) for name, (value,) in bench.gains(best[None]).items()}
    others = Bench(rig, law, axis, unseen_trials(rig, axis, choice.trials, choice.unseen), wanted, choice.only)
    new, old = (Judged(bench.judge(gains), others.judge(gains)) for gains in (found, bench.known_gains()))
    kept = not is_better(new, old, least)
    return Found(old, new, met, bench.known_gains() if kept else found, kept)


def all_or_none(found: Sequence[Found | DrawnFound]) -> list[Found | DrawnFound]:
    """Of a file that does not state every gain that was searched no axis can keep its own while another changes: all
    keep theirs then, unless every one found better.
    """
    whole = all(axis.gains.keys() == found[0].gains.keys() for axis in found)
    if whole or not any(axis.kept for axis in found):
        return list(found)
    return [axis._replace(kept=True) for axis in found]


class AxisSearch(NamedTuple):
    """One axis' search as it travels: the rig as JSON, and the arguments of tune_axis."""

    rig: str
    law: str
    axis: int
    choice: Choice


def run_search(job: AxisSearch) -> Found | DrawnFound:
    """As tune_axis, on whatever machine this is."""
    rig = RigConfig.model_validate_json(job.rig)
    return tune_axis(rig, job.law, job.axis, job.choice, lambda outcome: None)


def refuse_short_margins(rig: RigConfig, least: Margins) -> None:
    """Raises RigError naming every axis whose loop is unstable, or whose margins are less than `least`."""
    report = check_stability(rig)
    lines = report.problems()
    for name, axis in report.axes.items():
        found = margins_of(axis)
        if axis.stable and found.short(least):
            lines.append(
                f"law '{rig.law.name}' on axis '{name}': margins of {found.gain_db:.2f} dB and {found.phase_deg:.1f} "
                f"deg, less than {least.gain_db:g} dB and {least.phase_deg:g} deg; nothing is written; more "
                "--generations, a lower --margin or --phase-margin would do"
            )
    if lines:
        raise RigError(lines)
