"""`hil inject RIG --specification`: every batch that the specification of the injection has a bar for, with its bars.

A row is a batch of its own: speed, cells, sensor. Figures of cells that are assumed are as good as these; the bars say
what detectors, phases and the stage make of them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isnan
from typing import Any, Final

from hil.control.motion.injection.verdict import Verdict
from hil.studies.inject.batch import Batch, Injected
from hil.studies.inject.judge import Line, judged, quantile, share_text

PIPETTE: Final = (
    "sensors.force.tool_mass=6e-5",
    "plant.sensors=[{sensor='force', measures='tip_force', axis='z', tool_mass=6e-5}, "
    "{sensor='shift', measures='cell_shift', axis='z', frame_s=0.0333333333, delay=0.05}, "
    "{sensor='tip', measures='tip_error', axis='z', frame_s=0.0333333333, delay=0.05}, "
    "{sensor='bolus', measures='bolus', axis='z', frame_s=0.0333333333, delay=0.05}]",
    "axes.z.motion.acceleration=0.05",
)
FADES: Final = (
    "sensors.force.decay=2.0",
    PIPETTE[1].replace("tool_mass=6e-5", "decay=2.0"),
)
MOUSE: Final = (
    'plant.dish.preset="mouse-mii"',
    "sensors.force.scale=1e-10",
    "sensors.force.noise=1e-7",
    "sensors.force.range=[-1e-3, 1e-3]",
    "sensors.force.stuck_ticks=200",
)
EACH: Final = (
    "no_cell", "rolled", "not_pierced", "double", "sensor_dead", "camera_frozen", "clogged", "stuck",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """how: of [motion.parameters]. words: overrides behind those of the equipment. anomalies: of the cells, repeated;
    empty: all are good.
    """

    name: str
    bars: Callable[[Batch, float], list[Line]]
    how: Mapping[str, Any] = field(default_factory=dict)
    words: Sequence[str] = ()
    anomalies: Sequence[str] = ()


def _found(median: float, most: float) -> Callable[[Batch, float], list[Line]]:
    """Contact and lurch alone, with bars of their own."""

    def bars(batch: Batch, limit: float) -> list[Line]:
        depths = [cell.found_depth * 1e6 for cell in batch.judged if not isnan(cell.found_depth)]
        lines = _lurch(batch, limit)
        if not depths:
            return lines
        middle, high = quantile(depths, 0.5), quantile(depths, 0.95)
        reached = f"{middle:.1f} / {high:.1f} of {len(depths)}"
        bar = f"<= {median:g} / {most:g} (median / 95 %)"
        return [Line("touch known, um deep", bar, reached, middle <= median and high <= most), *lines]

    return bars


def _of(batch: Batch, limit: float, *begin: str) -> list[Line]:
    """The usual bars whose names begin so."""
    return [line for line in judged(batch, limit) if line.name.startswith(begin)]


def _lurch(batch: Batch, limit: float) -> list[Line]:
    return _of(batch, limit, "further", "pulses")


def _good(batch: Batch, limit: float) -> list[Line]:
    """Of good cells; and every puncture within 7 ms, none where there is none."""
    known = [cell.known_after * 1e3 for cell in batch.judged if not isnan(cell.known_after)]
    lines = judged(batch, limit)
    if known:
        lines.append(Line("puncture known after, ms, always", "<= 7", f"{max(known):.1f}", max(known) <= 7.0))
    return [*lines, _false(batch, "punctures that were none", lambda cell: (cell.result.pierced_s, cell.known_after))]


def _nothing(batch: Batch, limit: float) -> list[Line]:
    return [_false(batch, "touches of nothing", lambda cell: (cell.result.found, cell.found_depth))]


def _false(batch: Batch, name: str, of: Callable[[Injected], tuple[float, float]]) -> Line:
    """How often something was seen that did not happen; at most once in a thousand cells."""
    wrong = sum(not isnan(seen) and isnan(true) for seen, true in map(of, batch.judged))
    most = max(1, len(batch.judged) // 1000)
    return Line(name, "<= 1 in 1000", share_text(wrong, len(batch.judged)), wrong <= most)


def _classes(batch: Batch, limit: float) -> list[Line]:
    """Each kind of cell by itself."""
    lines = _of(batch, limit, "greatest", "pulses")
    for anomaly in EACH:
        cells = [cell for cell in batch.judged if cell.anomaly == anomaly]
        right = sum(cell.right for cell in cells)
        if cells:
            lines.append(
                Line(f"verdict: {anomaly}", ">= 90 %", share_text(right, len(cells)), right >= 0.9 * len(cells))
            )
    return lines


def _fades(batch: Batch, limit: float) -> list[Line]:
    most = max((cell.peak_force for cell in batch.cells), default=0.0) / limit
    return [Line("greatest force on any cell", f"<= 1.10 of {limit * 1e3:g} mN", f"{most:.3f}", most <= 1.10)]


def _verdicts(batch: Batch, limit: float) -> list[Line]:
    return _of(batch, limit, "verdicts", "pulses")


def _held(batch: Batch, limit: float) -> list[Line]:
    found = judged(batch, limit, 4e-4)
    return [
        line for line in found if "held" in line.name or line.name in ("verdicts", "pulses into a cell that is whole")
    ]


ROWS: Final = (
    Row("good cells, 4 mm/s", _good),
    Row("good cells, 1 mm/s", _found(24.0, 32.0), {"seek_speed": 1e-3, "press_speed": 1e-3}),
    Row("good cells, 0.1 mm/s", _lurch, {"seek_speed": 1e-3, "press_speed": 1e-4}),
    Row(
        "mouse-like cells, 0.3 mm/s, 0.1 uN",
        _found(7.0, 9.0),
        {"seek_speed": 3e-4, "press_speed": 3e-4, "force_limit": 2e-5, "pull_limit": 5e-6, "deposit": 6e-5,
         "deepest": 8e-5},
        MOUSE,
    ),
    Row("no cells", _nothing, anomalies=("no_cell",)),
    Row("each kind of cell", _classes, anomalies=EACH),
    Row("0.4 mN held", _held, {"z_law": "hold"}),
    Row("sensor that fades in 2 s, cells that bear much", _fades, words=FADES, anomalies=("not_pierced",)),
    Row(
        "sensor on the pipette, 60 mg",
        _verdicts,
        {"seek_speed": 1e-3, "press_speed": 1e-3},
        PIPETTE,
    ),
)  # fmt: skip


def anomalies_of(row: Row, cells: int) -> list[str]:
    """One for each cell, kind by kind in turn."""
    return [row.anomalies[number % len(row.anomalies)] for number in range(cells)] if row.anomalies else []


def named(row: Row, lines: Sequence[Line]) -> list[Line]:
    """The lines with the row's name before them."""
    return [line._replace(name=f"{row.name}: {line.name}") for line in lines]


def ended(row: Row, batch: Batch) -> list[Line]:
    """A line for a batch that did not end as it should."""
    broken = bool(batch.cells) and batch.cells[-1].result.verdict is Verdict.BROKEN
    why = batch.failure or batch.fault or ("the tip is broken" if broken else "")
    if not why and len(batch.cells) == batch.planned:
        return []
    return [Line(f"{row.name}: the batch", "ends", f"{len(batch.cells)} of {batch.planned}: {why}", False)]
