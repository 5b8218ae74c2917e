"""How accurately and repeatably an axis is positioned: the figures of ISO 230-2:2014, from approaches of both sides.

Deviations are where an axis came to rest less where it was sent, m (rad). Those of runs have the shape (targets, runs).
"""

from typing import Final, NamedTuple

import numpy as np

from hil.control.laws.base import Array

LEAST_TARGETS: Final = 5  # of the standard, on an axis of up to 2 m
LEAST_RUNS: Final = 5
_SPREAD: Final = 0.3  # of the interval: how far a target lies from an even spacing, so that no period of a scale hides


class Positioning(NamedTuple):
    """Of one axis, m (rad), with the standard's letters. up: approached in positive direction. mean_up and the like:
    mean and standard deviation of the runs at each target, (targets,).
    """

    accuracy: float  # A, of both directions
    accuracy_up: float
    accuracy_down: float
    systematic: float  # E
    mean_range: float  # M
    repeatability: float  # R, of both directions
    repeatability_up: float
    repeatability_down: float
    reversal: float  # B
    mean_up: Array
    mean_down: Array
    spread_up: Array
    spread_down: Array


def targets(low: float, high: float, count: int) -> list[float]:
    """Positions from `low` to `high` in nearly even steps, the ends among them, the same every time. count: >= 2."""
    step = (high - low) / (count - 1)
    golden = 0.5 * (5.0**0.5 - 1.0)
    inner = [low + step * (k + _SPREAD * (2.0 * ((k * golden) % 1.0) - 1.0)) for k in range(1, count - 1)]
    return [low, *inner, high]


def positioning(ups: Array, downs: Array) -> Positioning:
    """The figures from deviations of at least two runs in either direction, (targets, runs).

    Raises ValueError where the shapes differ, or there are fewer.
    """
    if ups.shape != downs.shape or ups.ndim != 2 or ups.shape[1] < 2 or not len(ups):
        raise ValueError(
            f"deviations of shapes {ups.shape} and {downs.shape}: expected (targets, runs), 2 runs or more"
        )
    mean_up, mean_down = ups.mean(axis=1), downs.mean(axis=1)
    s_up, s_down = ups.std(axis=1, ddof=1), downs.std(axis=1, ddof=1)
    reversal = mean_up - mean_down
    mean = 0.5 * (mean_up + mean_down)
    both = np.maximum(2.0 * (s_up + s_down) + np.abs(reversal), 4.0 * np.maximum(s_up, s_down))
    return Positioning(
        accuracy=_range(
            [mean_up + 2.0 * s_up, mean_down + 2.0 * s_down], [mean_up - 2.0 * s_up, mean_down - 2.0 * s_down]
        ),
        accuracy_up=_range([mean_up + 2.0 * s_up], [mean_up - 2.0 * s_up]),
        accuracy_down=_range([mean_down + 2.0 * s_down], [mean_down - 2.0 * s_down]),
        systematic=_range([mean_up, mean_down], [mean_up, mean_down]),
        mean_range=_range([mean], [mean]),
        repeatability=float(both.max()),
        repeatability_up=float(4.0 * s_up.max()),
        repeatability_down=float(4.0 * s_down.max()),
        reversal=float(np.abs(reversal).max()),
        mean_up=mean_up,
        mean_down=mean_down,
        spread_up=s_up,
        spread_down=s_down,
    )


def _range(most: list[Array], least: list[Array]) -> float:
    return float(max(values.max() for values in most) - min(values.min() for values in least))
