"""Whether an axis has become worse, or better, over its last runs: a rule that scatter and single bad runs do not meet.

Runs are compared where rig (by its hash: gains, task and all), clock and axis are the same. Of the last OVER of them:

- the change is that of the line whose slope is the median of the slopes between all pairs of runs, in the logarithm of
  the RMS error (Theil 1950, Sen 1968). Up to 29 % of the runs may be anything without moving it far;
- the evidence is Mann and Kendall's: how many pairs of runs went up less how many went down, by its spread where the
  order of the runs is chance (Mann 1945, Kendall 1975; with ties). It knows no size, so that one bad run counts little.

A drift is a change of at least LEAST with evidence of at least SURE, which chance reaches in one of 1000 series.
"""

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from statistics import median
from typing import Any, NamedTuple

from hil.runs.listed import ListedRun

OVER = 20  # runs
FEWEST = 10
LEAST = 0.05  # a drift of 10 % is told in spite of some scatter
SURE = 3.29  # standard deviations: two-sided, 1 in 1000


class Trend(NamedTuple):
    """Of one axis. runs: how many were compared. before, after: RMS error at both ends of the line, m (rad). change: of
    the line over all of them, 0.1 for 10 %. evidence: standard deviations, positive upwards.
    """

    rig: str
    law: str
    clock: str
    rig_hash: str
    axis: str
    kind: str
    runs: int
    before: float
    after: float
    change: float
    evidence: float

    @property
    def drifts(self) -> bool:
        """Whether the axis has drifted, by the rule above."""
        return self.runs >= FEWEST and abs(self.change) >= LEAST and abs(self.evidence) >= SURE

    @property
    def document(self) -> dict[str, Any]:
        """For JSON."""
        return {**self._asdict(), "drifts": self.drifts}


def trends(found: Iterable[ListedRun], over: int = OVER) -> list[Trend]:
    """Of every axis of every rig with three runs or more, of which the newest `over` count; the oldest run first.

    Left out are runs that ended in a stop, or lack ticks, and errors that are zero or absent.
    """
    series: dict[tuple[str, str, str], list[tuple[ListedRun, float]]] = {}
    for run in found:
        facts = run.facts
        if facts["outcome"] != "sound" or facts["missing"]:
            continue
        for name, row in facts["axes"].items():
            if math.isfinite(row["rms_error"]) and row["rms_error"] > 0.0:
                series.setdefault((facts["rig_hash"], facts["clock"], name), []).append((run, row["rms_error"]))
    return [_trend(key[2], runs[-over:]) for key, runs in series.items() if len(runs) > 2]


def _trend(axis: str, runs: Sequence[tuple[ListedRun, float]]) -> Trend:
    facts = runs[-1][0].facts
    logs = [math.log(error) for _, error in runs]
    rise = slope(logs)
    middle = median(value - rise * place for place, value in enumerate(logs))
    last = middle + rise * (len(logs) - 1)
    return Trend(
        facts["rig"], facts["law"], facts["clock"], facts["rig_hash"], axis, facts["axes"][axis]["kind"], len(logs),
        math.exp(middle), math.exp(last), math.expm1(last - middle), evidence(logs),
    )  # fmt: skip


def slope(values: Sequence[float]) -> float:
    """The median of the slopes between all pairs of equally spaced values, at least two."""
    pairs = itertools.combinations(enumerate(values), 2)
    return median((after - before) / (second - first) for (first, before), (second, after) in pairs)


def evidence(values: Sequence[float]) -> float:
    """Mann and Kendall's test: pairs that rise less those that fall, in standard deviations, with its continuity step;
    0 where all are equal.
    """
    score = sum((after > before) - (after < before) for before, after in itertools.combinations(values, 2))
    ties = Counter(values).values()
    variance = (_spread(len(values)) - sum(map(_spread, ties))) / 18.0
    return (score - math.copysign(1.0, score)) / math.sqrt(variance) if score and variance > 0.0 else 0.0


def _spread(count: int) -> int:
    return count * (count - 1) * (2 * count + 5)
