"""Bars for a batch, and what it reached: medians, 95 %, and shares with their Wilson intervals."""

from collections.abc import Sequence
from math import isnan, sqrt
from typing import NamedTuple

import numpy as np

from hil.control.motion.injection.verdict import Verdict
from hil.studies.inject.batch import Batch, Injected

Z95 = 1.959964  # of the normal distribution


class Line(NamedTuple):
    """One bar. holds: None where the batch had nothing to say of it."""

    name: str
    bar: str
    reached: str
    holds: bool | None


def wilson(hits: int, total: int) -> tuple[float, float]:
    """The 95 % interval of a share, by Wilson (JASA 22, 1927). total: 1 or more."""
    share, z2 = hits / total, Z95 * Z95
    centre = (share + z2 / (2 * total)) / (1 + z2 / total)
    half = Z95 * sqrt(share * (1 - share) / total + z2 / (4 * total * total)) / (1 + z2 / total)
    return max(0.0, centre - half), min(1.0, centre + half)


def quantile(values: Sequence[float], share: float) -> float:
    """As `hil evidence` has them. values: one or more."""
    return float(np.quantile(values, share, method="higher"))


def share_text(hits: int, total: int) -> str:
    """As tables show it."""
    low, high = wilson(hits, total)
    return f"{hits} of {total} [{low:.1%}, {high:.1%}]"


def judged(batch: Batch, force_limit: float, hold_force: float = 0.0) -> list[Line]:
    """Every bar of the specification that a batch can be held against. force_limit: N. hold_force: N, that was
    held; 0: none was. Cells that an operator took out of the batch count in none but force and pulses.
    """
    cells = batch.judged
    right = sum(cell.right for cell in cells)
    lines = [
        Line("verdicts", ">= 99 %", share_text(right, len(cells)), right >= 0.99 * len(cells)) if cells else None,
        _pierced(cells),
        _quantiles("touch known, um deep", [cell.found_depth * 1e6 for cell in cells], 35.0, 42.0),
        _quantiles("puncture known after, ms", [cell.known_after * 1e3 for cell in cells], 4.0, 5.0),
        _lurch(cells),
        _held(cells),
        _held_peak(cells, hold_force),
        _force(batch.cells, force_limit),
        _pulses(batch.cells),
        _pace(batch),
    ]
    return [line for line in lines if line is not None]


def _pierced(cells: Sequence[Injected]) -> Line | None:
    good = [cell for cell in cells if cell.anomaly == "" and cell.expected is Verdict.OK]
    if not good:
        return None
    hits = sum(cell.result.verdict is Verdict.OK for cell in good)
    return Line("good cells pierced", ">= 99.4 %", share_text(hits, len(good)), hits >= 0.994 * len(good))


def _quantiles(name: str, values: Sequence[float], middle: float, most: float) -> Line | None:
    known = [value for value in values if not isnan(value)]
    if not known:
        return None
    median, high = quantile(known, 0.5), quantile(known, 0.95)
    bar = f"<= {middle:g} / {most:g} (median / 95 %)"
    return Line(name, bar, f"{median:.1f} / {high:.1f} of {len(known)}", median <= middle and high <= most)


def _lurch(cells: Sequence[Injected]) -> Line | None:
    shares = [
        cell.lurch / cell.result.pierced_speed
        for cell in cells
        if not isnan(cell.lurch) and cell.result.pierced_speed > 0.0
    ]
    if not shares:
        return None
    high = quantile(shares, 0.95) * 1e3
    return Line("further on behind the puncture", "<= 6.7 ms of the speed (95 %)", f"{high:.1f} ms", high <= 6.7)


def _held(cells: Sequence[Injected]) -> Line | None:
    rms = [cell.result.held_rms * 1e6 for cell in cells if not isnan(cell.result.held_rms)]
    if not rms:
        return None
    median, high = quantile(rms, 0.5), quantile(rms, 0.95)
    return Line(
        "reading of a held force, uN RMS", "<= 8 (95 %)", f"{median:.1f} / {high:.1f} of {len(rms)}", high <= 8.0
    )


def _held_peak(cells: Sequence[Injected], hold_force: float) -> Line | None:
    burst = [cell.peak_force for cell in cells if cell.result.verdict is Verdict.BURST]
    held = burst + [cell.peak_force for cell in cells if not isnan(cell.result.held_rms)]
    if not held:
        return None
    most = max(held) / hold_force
    return Line("greatest force where one was held", "<= 1.05 of it", f"{most:.3f}", most <= 1.05)


def _force(cells: Sequence[Injected], limit: float) -> Line | None:
    if not cells:
        return None
    most = max(cell.peak_force for cell in cells) / limit
    return Line("greatest force on any cell", f"<= 1.05 of {limit * 1e3:g} mN", f"{most:.3f}", most <= 1.05)


def _pulses(cells: Sequence[Injected]) -> Line | None:
    wrong = sum(cell.wrong_pulses for cell in cells)
    return Line("pulses into a cell that is whole", "never", str(wrong), wrong == 0)


def _pace(batch: Batch) -> Line | None:
    held = any(not isnan(cell.result.held_rms) for cell in batch.cells)  # which takes as long as it is to
    if not batch.cells or not batch.seconds or held:
        return None
    pace = 60.0 * (len(batch.cells) - batch.earlier) / batch.seconds
    return Line("cells a minute", ">= 40", f"{pace:.0f}", pace >= 40.0)
