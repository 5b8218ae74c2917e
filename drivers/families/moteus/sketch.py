"""What `hil new` writes for moteus controllers."""

import math
from collections.abc import Sequence

from drivers.families import Sketched, SketchedAxis

_COUNTS = 100_000  # per turn of a controller's output shaft


def sketch(name: str, axes: Sequence[SketchedAxis], watchdog_s: float) -> Sketched:
    """Numbers from 1, and what a controller makes of its torque, by the travel of a turn."""
    nodes = [*range(1, len(axes) + 1)]
    tables = f"[bus.moteus]\nnodes = {nodes}  # id.id of each\nwatchdog_s = {watchdog_s:g}\n"
    return Sketched(tables, [_gear(axis) for axis in axes])


def _gear(axis: SketchedAxis) -> str:
    turn = _COUNTS * axis.encoder
    gear = float(f"{2.0 * math.pi / turn:.6g}")
    return f"gear = {gear!r}  # 2 pi over the {turn:g} of a turn of the output shaft"
