"""Figures of merit over a steady window."""

from collections.abc import Sequence
from typing import Literal, TypedDict

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Figure = Literal["max_error", "rms_error", "plateau_error", "peak_force", "chatter"]

NOT_SETTLED = "too short: not settled"  # of figures that hold the approach


class Figures(TypedDict):
    """Of one axis, m and N (rad, N m). plateau_error: the median of |error|, what a constant disturbance leaves.
    chatter: RMS of the force's change from tick to tick.
    """

    max_error: float
    rms_error: float
    plateau_error: float
    peak_force: float
    chatter: float


def axis_statistics(names: Sequence[str], error: Array, force: Array) -> dict[str, Figures]:
    """Figures of every axis.

    error, force: (ticks, n_axes); NaN errors (ticks without a sample) do not count. Without any sample all errors are
    NaN.
    """
    result: dict[str, Figures] = {}
    for axis, name in enumerate(names):
        valid = error[:, axis][np.isfinite(error[:, axis])]
        magnitude = np.abs(valid) if valid.size else np.full(1, np.nan)
        change = np.diff(force[:, axis]) if len(force) > 1 else np.zeros(1)
        result[name] = {
            "max_error": float(magnitude.max()),
            "rms_error": float(np.sqrt(np.mean(magnitude**2))),
            "plateau_error": float(np.median(magnitude)),
            "peak_force": float(np.abs(force[:, axis]).max()) if len(force) else 0.0,
            "chatter": float(np.sqrt(np.mean(change**2))),
        }
    return result
