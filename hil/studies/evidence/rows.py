"""What draws pool to: median and 95 % of a figure, with intervals that hold whatever its distribution is."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hil.control.laws.base import Array
from hil.studies.evidence.trials import REST, Job

CONFIDENCE = 0.95


def quantile_interval(values: Array, share: float) -> tuple[float, float]:
    """Between which of the values (n,) that quantile lies, by CONFIDENCE: order statistics, from the binomial
    distribution of how many draws lie below it. The upper end is infinite where too few were drawn to have one.
    """
    from scipy.stats import binom  # it takes long to import

    ordered, count = np.sort(values), values.size
    below = (1.0 - CONFIDENCE) / 2.0
    first = int(binom.ppf(below, count, share))
    last = int(binom.ppf(1.0 - below, count, share))
    return float(ordered[max(first - 1, 0)]), float(ordered[last]) if last < count else float("inf")


def pooled(names: Sequence[str], work: Sequence[Job], found: Sequence[dict[str, Array]]) -> list[dict[str, Any]]:
    """Median and 95 % of every figure, by axis, their intervals, that of each stage, and seed and number of the worst.
    Jobs that differ in their seed alone are one row. A stage that failed counts as worse than all others: infinite.
    """
    alike: dict[tuple[Any, ...], list[tuple[Job, dict[str, Array]]]] = {}
    for job, figures in zip(work, found, strict=True):
        alike.setdefault((job.mode_hz, job.trial), []).append((job, figures))
    return [row for group in alike.values() for row in _rows(names, group)]


def _rows(names: Sequence[str], group: Sequence[tuple[Job, dict[str, Array]]]) -> list[dict[str, Any]]:
    first, figures = group[0]
    stages = [(job.seed, number) for job, _ in group for number in range(job.stages)]
    failed = np.concatenate([found["failed"] for _, found in group])
    rows = []
    for figure in figures:
        if figure == "failed":
            continue
        worst = np.where(failed, np.inf, np.concatenate([found[figure] for _, found in group]))
        axes = {name: _axis(worst[:, i], failed[:, i], stages) for i, name in enumerate(names)}
        name = figure if first.trial.name == REST else f"{first.trial.name}: {figure}"
        rows.append({"mode_hz": first.mode_hz, "figure": name, "axes": axes})
    return rows


def _axis(worst: Array, failed: Array, stages: Sequence[tuple[int, int]]) -> dict[str, Any]:
    return {
        "median": float(np.quantile(worst, 0.5, method="higher")),
        "median_interval": quantile_interval(worst, 0.5),
        "p95": float(np.quantile(worst, 0.95, method="higher")),
        "p95_interval": quantile_interval(worst, 0.95),
        "failed": int(failed.sum()),
        "worst": stages[int(np.argmax(worst))],
        "each": worst.tolist(),
    }
