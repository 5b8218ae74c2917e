"""What every cell of the fault campaign found, on the shipped rigs with layouts of their own: trial by trial."""

import os
from collections.abc import Iterable
from functools import cache

from hil.studies.fault_campaign.campaign import campaign
from hil.studies.fault_campaign.matrix import Cell
from tests.support.paths import RIGS

SLOW = True  # minutes


def stories() -> list[str]:
    """Their names."""
    return ["paper"]


@cache
def tell(story: str) -> list[str]:
    """Of a rig. Raises AssertionError where a cell does not pass."""
    cells = campaign([RIGS / f"{story}.toml"], 1, os.cpu_count() or 1, lambda done, total: None)
    failed = [f"{cell.checkpoint} / {cell.trial} / {cell.axis}: {cell.why}" for cell in cells if not cell.passed]
    assert not failed, "\n".join(failed)
    return lines(cells)


def lines(cells: Iterable[Cell]) -> list[str]:
    """Of each trial, a line a checkpoint."""
    trials: dict[str, dict[str, list[str]]] = {}
    for cell in cells:
        found = f"{cell.fault} after {cell.detection_ticks} ticks, {cell.reaction}" if cell.fault else "nothing"
        force = f", then at most {cell.peak_force_after:.9g} of its unit" if cell.peak_force_after else ""
        axis = "" if cell.axis == "-" else f"{cell.axis} "
        trials.setdefault(cell.trial, {}).setdefault(cell.checkpoint, []).append(f"{axis}{found}{force}, {cell.end}")
    return [
        line
        for trial, checkpoints in trials.items()
        for line in (trial, *(f"    {name}: {'; '.join(told)}" for name, told in checkpoints.items()))
    ]
