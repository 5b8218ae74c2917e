"""What `hil tune` prints of a search: before and after, in the trials and on plants not searched, and what it cost."""

from collections.abc import Sequence
from typing import Any

from hil.cli.output import metres
from hil.control.law_registry import is_built_in, law_class
from hil.rig.schema import RigConfig
from hil.studies.tune.objective import trials_of
from hil.studies.tune.search import Choice, Found, front
from hil.studies.tune.search_space import law_of

AIM = "target 1.0"  # of the cost that the progress line tells
SAME = 0.01  # relative: no more than this is no change worth a word


def announced(rig: RigConfig, law: str, choice: Choice, names: Sequence[str]) -> str:
    """The line before the search: how much it is, and how to have less of it."""
    (population, generations), axes = choice.size, ", ".join(names)
    tried = len(trials_of(rig, 0, choice.trials, choice.repeats))
    chosen = law_of(rig, law)
    quick = is_built_in(chosen) or law_class(chosen).elementwise
    slow = "" if quick else ". With elementwise = True your law is searched faster (docs/laws.md)"
    return (
        f"{generations} generations of {population} candidates, after a first draw, for each of {axes}; each of them "
        f"runs {tried} trials. For a first look: --population 8 --generations 4 --dry-run{slow}"
    )


def achieved(rig: RigConfig, names: Sequence[str], found: Sequence[Found]) -> str:
    """The line written beside the gains."""
    parts = []
    for name, axis in zip(names, found, strict=True):
        error, _, _, _, gain_db, phase_deg, _ = (float(values[0]) for values in axis.now.searched)
        kept = " (kept)" if axis.kept else ""
        parts.append(f"{name} {metres(error, rig.axes[name].kind)}, {gain_db:.1f} dB, {phase_deg:.0f} deg{kept}")
    return f"error in the worst trial, gain and phase margin: {'; '.join(parts)}"


def show(console: Any, rig: RigConfig, names: Sequence[str], found: Sequence[Found]) -> None:
    """Tables, what was traded against what, and the trade among all candidates met."""
    from rich.table import Table

    title = "the file's gains -> those found; costs as multiples of a good result (target 1.0)"
    columns = ("error", "worst", "median", "unseen: worst", "median", "chatter", "gain margin", "phase margin")
    table = Table("axis", *columns, "", title=title)
    for name, axis in zip(names, found, strict=True):
        table.add_row(name, *_row(axis, rig.axes[name].kind), "kept" if axis.kept else "new")
    console.print(table)
    for name, axis in zip(names, found, strict=True):
        console.print(f"{name}: {verdict(axis)}", markup=False)
    for name, axis in zip(names, found, strict=True):
        kind = rig.axes[name].kind
        for column, sign, unit in ((1, 1.0, "chatter per tick"), (2, -1.0, "dB of gain margin")):
            trade = front(axis.met[:, [0, column]] * [1.0, sign])
            picked = trade[:: max(len(trade) // 6, 1)][:7]
            shown = "; ".join(f"{metres(error, kind)} at {sign * price:.3g}" for error, price in picked)
            console.print(f"trade on {name}, error in the worst trial at {unit}: {shown}")


def _row(axis: Found, kind: str) -> list[str]:
    old, new = axis.before, axis.best
    error = " -> ".join(metres(float(each.searched.error[0]), kind) for each in (old, new))
    pairs = [
        (old.searched.ratio, new.searched.ratio),
        (old.searched.median, new.searched.median),
        (old.unseen.ratio, new.unseen.ratio),
        (old.unseen.median, new.unseen.median),
        (old.searched.chatter, new.searched.chatter),
        (old.searched.gain_db, new.searched.gain_db),
        (old.searched.phase_deg, new.searched.phase_deg),
    ]
    return [error, *(f"{float(one[0]):.3g} -> {float(two[0]):.3g}" for one, two in pairs)]


def verdict(axis: Found) -> str:
    """In words: what the gains found are better and worse at, and whether they replace the file's."""
    old, new = axis.before, axis.best
    figures = {  # before, after; the less the better
        "the worst trial": (old.searched.ratio, new.searched.ratio),
        "the median trial": (old.searched.median, new.searched.median),
        "the worst unseen plant": (old.unseen.ratio, new.unseen.ratio),
        "the median unseen plant": (old.unseen.median, new.unseen.median),
        "chatter": (old.searched.chatter, new.searched.chatter),
        "gain margin": (-old.searched.gain_db, -new.searched.gain_db),
        "phase margin": (-old.searched.phase_deg, -new.searched.phase_deg),
    }
    better: list[str] = []
    worse: list[str] = []
    for name, (before, after) in figures.items():
        one, two = float(before[0]), float(after[0])
        if abs(two - one) > SAME * abs(one):
            (better if two < one else worse).append(f"{name} ({abs(one):.3g} -> {abs(two):.3g})")
    gained, paid = "; ".join(better) or "nothing", "; ".join(worse) or "nothing"
    if axis.kept:
        return f"the file's gains are kept; those found are better at {gained}; worse at {paid}"
    return f"new gains: {gained}; paid for with: {paid}"
