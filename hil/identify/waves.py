"""Waves of friction and of force along the travel, as places show them.

The balance is linear except for the periods along the travel, which are searched.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import least_squares

from hil.identify.estimate import Array
from hil.identify.places import Points, seen

PERIODS, SEEDS = 32, 3  # tried of each kind, and refined
GAIN = 1.5  # by which a sinusoid along the travel must lower the residual's square to be told
LEAST_PARTS, LONGEST = 4.0, 4.0  # periods are searched from the travel over the first squared to this many of it
# Of friction from travel / FINEST on, as rolling elements pass: so many tried for each period in the travel.
FINEST, DENSITY = 120.0, 2.5
ASTRAY = 9.0  # of the logarithm of a period over the travel, in the search
BASE = ("coulomb", "constant", "cable_stiffness")


def design(points: Points, waves: Sequence[tuple[bool, float]], *, blurred: bool = True) -> Array:
    """(k, n): BASE, then sine and cosine of every wave; a wave of friction (True) changes sign with the direction.
    blurred: as filter and places show them.
    """
    direction = np.sign(points.velocity)
    rows = [direction, np.ones_like(direction), points.position]
    for odd, length in waves:
        angle = 2.0 * np.pi * points.position / length
        factor = (direction if odd else 1.0) * (seen(points, length) if blurred else 1.0)
        rows += [factor * np.sin(angle), factor * np.cos(angle)]
    return np.array(rows)


def within_travel(
    waves: Sequence[tuple[bool, float]], x: Array, travel: float
) -> tuple[list[tuple[bool, float]], Array]:
    """The waves that are no longer than the travel, m, and the weights of them and of BASE."""
    short = np.array([length <= travel for _, length in waves], bool)
    kept = [wave for wave, is_short in zip(waves, short.tolist(), strict=True) if is_short]
    return kept, np.concatenate([x[: len(BASE)], x[len(BASE) :][np.repeat(short, 2)]])


def waves_seen(points: Points, waves: Sequence[tuple[bool, float]], x: Array) -> Array:
    """Their force as filter and places show it at constant speed, N (k,)."""
    told: Array = x[len(BASE) :] @ design(points, waves)[len(BASE) :]
    return told


def waves_force(waves: Sequence[tuple[bool, float]], x: Array, centre: float) -> Callable[[Array, int], Array]:
    """Their force, N, by position, m, and direction, 1 or -1. centre: from where x counts, m."""

    def force(position: Array, direction: int) -> Array:
        total = np.zeros(position.size)
        for (odd, length), (sine, cosine) in zip(waves, x[len(BASE) :].reshape(-1, 2), strict=True):
            angle = 2.0 * np.pi * (position - centre) / length
            total += (direction if odd else 1.0) * (sine * np.sin(angle) + cosine * np.cos(angle))
        return total

    return force


def solve(points: Points, waves: Sequence[tuple[bool, float]]) -> tuple[Array, Array]:
    """What each row of the design weighs (k,), and the force that is left, N (n,)."""
    a = design(points, waves)
    size = np.sqrt((a * a).mean(axis=1))
    size[size == 0.0] = 1.0
    x, *_ = np.linalg.lstsq((a / size[:, None]).T, points.force, rcond=1e-9)
    return x / size, points.force - x @ (a / size[:, None])


def _square(points: Points, waves: Sequence[tuple[bool, float]]) -> float:
    rest = solve(points, waves)[1]
    return float(rest @ rest)


def searched(points: Points) -> list[tuple[bool, float]]:
    """The periods along the travel that are worth it: one of friction, one of the place, searched together."""
    travel = float(np.ptp(points.position))
    lengths = np.geomspace(travel / LEAST_PARTS**2, LONGEST * travel, PERIODS).tolist()
    counts = np.arange(LEAST_PARTS**2, FINEST, 1.0 / DENSITY)
    fine = sorted((travel / counts).tolist(), key=lambda length: _square(points, [(True, length)]))
    single = [[(odd, length)] for odd in (True, False) for length in lengths]
    single += [[(True, length)] for length in fine[:SEEDS]]
    pairs = [[(True, odd), (False, even)] for odd in lengths + fine[:1] for even in lengths]
    best: list[tuple[bool, float]] = []
    least = _square(points, best)
    for tried in (single, pairs):
        seeds = sorted(tried, key=lambda waves: _square(points, waves))[:SEEDS]
        found = [refined(points, waves) for waves in seeds]
        squares = [_square(points, waves) for waves in found]
        if min(squares) * GAIN < least:
            least, best = min(squares), found[int(np.argmin(squares))]
    return best


def refined(points: Points, waves: Sequence[tuple[bool, float]]) -> list[tuple[bool, float]]:
    """The periods where the residual is least, from these on."""
    if not waves:
        return []
    kinds = [odd for odd, _ in waves]
    size, middle = float(np.sqrt((points.force**2).mean())), math.log(float(np.ptp(points.position)))

    def lengths(logs: Array) -> list[float]:
        """Within what a search may try and numbers bear."""
        found: list[float] = np.exp(np.clip(logs, middle - ASTRAY, middle + ASTRAY)).tolist()
        return found

    def rest(logs: Array) -> Array:
        left: Array = solve(points, list(zip(kinds, lengths(logs), strict=True)))[1]
        return left / size

    done = least_squares(rest, np.log([length for _, length in waves]), max_nfev=40, xtol=1e-10, ftol=1e-12)
    return list(zip(kinds, lengths(done.x), strict=True))
