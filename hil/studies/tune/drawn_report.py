"""What `hil tune --trials drawn` prints and writes: as report.py for the other trials."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hil.cli.output import metres
from hil.rig.schema import RigConfig
from hil.studies.tune import drawn_stages
from hil.studies.tune.drawn_search import DrawnFound
from hil.studies.tune.drawn_stages import fresh_seeds
from hil.studies.tune.search import Choice

AIM = "1.0 is what the gains there are cost"  # of the cost that the progress line tells


def announced(_rig: RigConfig, _law: str, choice: Choice, names: Sequence[str]) -> str:
    """The line before the search: how much it is."""
    seeds, (population, generations) = ", ".join(map(str, fresh_seeds(choice.seed))), choice.size
    return (
        f"{generations} generations of {population} candidates, after a first draw, for each of {', '.join(names)}; "
        f"each of them runs the task on {drawn_stages.STAGES} drawn stages (seed {choice.seed}). The best is judged on "
        f"{choice.unseen} fresh stages (seeds {seeds}). For a first look: --population 8 --generations 2 --dry-run"
    )


def told(name: str, kind: str, found: DrawnFound) -> str:
    """In words: what the best gains found do, and whether they replace those there are."""
    old, new = found.compared.fresh
    if reasons := found.compared.reasons_to_keep():
        whose = "the file's gains stand" if found.stated else "the default gains stand"
        return f"{name}: {whose}: {'; '.join(reasons)}"
    mean, low, high = (100.0 * (np.exp(value) - 1.0) for value in found.compared.change)
    peak, rms = (
        " -> ".join(metres(one.quantile(figure, 0.5), kind) for one in (old, new)) for figure in ("peak", "rms")
    )
    return (
        f"{name}: new gains: on {new.peak.size} fresh stages median peak {peak}, median RMS {rms}; error per stage "
        f"{mean:+.0f} % ({low:+.0f} to {high:+.0f} %)"
    )


def show(console: Any, rig: RigConfig, names: Sequence[str], found: Sequence[DrawnFound]) -> None:
    """A table of both sides, and a line for each axis."""
    from rich.table import Table

    title = "the gains there are -> the best found, on the task after it is learnt; median / 95 % of the stages"
    table = Table("axis", "stages", "peak", "RMS error", "lost", "gain margin", "phase margin", title=title)
    for name, axis in zip(names, found, strict=True):
        kind = rig.axes[name].kind
        nominal = [loop.nominal for loop in axis.compared.loops]
        margins = [
            " -> ".join(f"{getattr(one, key):.1f}" if one.stable else "unstable" for one in nominal)
            for key in ("gain_db", "phase_deg")
        ]
        for stages, pair in (("searched", axis.compared.searched), ("fresh", axis.compared.fresh)):
            errors = [
                " -> ".join(
                    f"{metres(one.quantile(figure, 0.5), kind)} / {metres(one.quantile(figure, 0.95), kind)}"
                    for one in pair
                )
                for figure in ("peak", "rms")
            ]
            lost = " -> ".join(str(one.lost.sum()) for one in pair)
            table.add_row(name, f"{pair[0].peak.size} {stages}", *errors, lost, *margins)
    console.print(table)
    for name, axis in zip(names, found, strict=True):
        console.print(told(name, rig.axes[name].kind, axis), markup=False)


def achieved(rig: RigConfig, names: Sequence[str], found: Sequence[DrawnFound]) -> str:
    """The line written beside the gains."""
    parts = []
    for name, axis in zip(names, found, strict=True):
        one, kind = axis.compared.fresh[0 if axis.kept else 1], rig.axes[name].kind
        both = " and ".join(metres(one.quantile(figure, 0.5), kind) for figure in ("peak", "rms"))
        parts.append(f"{name} {both} of {one.peak.size}{' (kept)' if axis.kept else ''}")
    return f"peak and RMS error, median over fresh stages: {'; '.join(parts)}"
