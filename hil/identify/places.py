"""Passes at constant speed, as the mean force over each place along the travel."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import gaussian_filter1d

from hil.identify.estimate import Array, Refused
from hil.identify.force_balance import CORNER_HZ, EDGE_S, lagged

# Of the travel, left out at the beginning of a pass, as cables that move along take a way to turn; at most of the pass.
LEAD, MOST_LEAD = 0.08, 0.25
STALL_S = 0.05, 0.15  # left out before a stall, for the filter, and behind it, until the loop is at rest again
LEAST_SEEN = 0.1
PLACES = 360  # along the travel; the force is averaged over each
OF_TRIANGLE = np.array([1.0, 3.0, 3.0, 1.0]) / 8.0  # over four periods, of each
SMOOTH_S = math.sqrt(math.log(2.0)) / (2.0 * math.pi * CORNER_HZ)  # standard deviation of the filter


class SpeedPass(NamedTuple):
    """One pass at constant speed, away from its ends: force as applied from each sample to the next (N), position
    (m) at the sample, (n,). speed: m/s, signed.
    stalled: indices at which the computer stalled; the places passed about then do not count.
    """

    force: Array
    position: Array
    speed: float
    stalled: Sequence[int] = ()


class Points(NamedTuple):
    """Of each place that a pass went over, (k,): mean force less inertia (N), position (m), velocity (m/s); the numbers
    of pass and place.
    """

    force: Array
    position: Array
    velocity: Array
    of_pass: Array
    place: Array


def seen(points: Points, length: float) -> Array:
    """Share of a sinusoid of that length (m) along the travel that filter and places leave of it, (k,). None where they
    leave less than LEAST_SEEN at any speed.
    """
    width = float(np.ptp(points.position)) / (PLACES - 1)
    share: Array = np.exp(-0.5 * (2.0 * np.pi * SMOOTH_S * points.velocity / length) ** 2) * np.sinc(width / length)
    return share if np.abs(share).max() >= LEAST_SEEN else np.zeros_like(share)


def points_of(passes: Sequence[SpeedPass], period: float, mass: float, lag: float) -> Points:
    """Mean force less inertia over each place, whole places only."""
    return _over_places(passes, period, [_force_less_inertia(one, period, mass, lag) for one in passes])


def shown(passes: Sequence[SpeedPass], period: float, force: Callable[[Array, int], Array]) -> Array:
    """What the same places show of a force that hangs on position (m) and direction (1 or -1), (k,)."""
    forces = [force(one.position, 1 if one.speed > 0.0 else -1) for one in passes]
    return _over_places(passes, period, [_mean_of_triangle(each) for each in forces]).force


def _over_places(passes: Sequence[SpeedPass], period: float, forces: Sequence[Array]) -> Points:
    """Means of the forces at the samples of each pass (n,), filtered as the position is, so that both are as late."""
    ends = [end for one in passes for end in (one.position.min(), one.position.max())]
    low, high = min(ends), max(ends)
    edges = np.linspace(low, high, PLACES + 1)
    columns: list[list[Array]] = [[], [], [], [], []]
    for number, (one, each) in enumerate(zip(passes, forces, strict=True)):
        position, force = (_smooth(values, one, period) for values in (one.position, each))
        turned = 1 if one.speed > 0.0 else -1
        lead = min(LEAD * (high - low), MOST_LEAD * float(np.ptp(one.position)))
        begin = one.position[0] + turned * lead
        first, last = sorted((begin, position[-1]))
        whole = np.flatnonzero((edges >= first) & (edges <= last))
        if whole.size < 2:
            raise Refused(f"a pass at {one.speed:.3g} m/s is at constant speed over {abs(last - first):.2g} m only")
        work = cumulative_trapezoid(force, position, initial=0.0)
        at = edges[whole]
        done = np.interp(at, position[::turned], work[::turned])
        when = np.interp(at, position[::turned], (period * np.arange(position.size))[::turned])
        width = np.diff(at)
        values = (np.diff(done) / width, 0.5 * (at[1:] + at[:-1]), width / np.diff(when))
        sound = _sound(when, one, period)
        for column, value in zip(columns, (*values, np.full(width.size, number), whole[:-1]), strict=True):
            column.append(value[sound])
    return Points(*(np.concatenate(column) for column in columns))


def _sound(when: Array, one: SpeedPass, period: float) -> NDArray[np.bool_]:
    """Whether a place was passed away from stalls, (k - 1,). when: s, at the places' edges, (k,)."""
    first, last = np.minimum(when[1:], when[:-1]), np.maximum(when[1:], when[:-1])
    sound = np.ones(first.size, bool)
    for at in (np.asarray(one.stalled, float) * period - EDGE_S).tolist():
        sound &= (last < at - STALL_S[0]) | (first > at + STALL_S[1])
    return sound


def _force_less_inertia(one: SpeedPass, period: float, mass: float, lag: float) -> Array:
    """At each sample, N. A difference over four periods shows an acceleration's mean with a triangle's weights: so is
    the force's taken, and what is left of both is such a mean of friction.
    """
    force = np.pad(lagged(one.force, lag, period), (2, 1), mode="edge")
    mean: Array = np.convolve(force, OF_TRIANGLE, mode="valid")
    return mean - mass * _second_difference(one.position) / period**2


def _mean_of_triangle(force: Array) -> Array:
    """Of a force of the place, by its curvature."""
    return force + _second_difference(force) / 3.0


def _second_difference(values: Array) -> Array:
    """Over four samples, 0 at the ends."""
    return np.pad(values[4:] - 2.0 * values[2:-2] + values[:-4], 2) / 4.0


def _smooth(values: Array, one: SpeedPass, period: float) -> Array:
    """Filtered; without the ends, where the filter has half its data."""
    edge = round(EDGE_S / period)
    if values.size < 3 * edge:
        raise Refused(f"a pass at {one.speed:.3g} m/s is at constant speed for {values.size * period:.2g} s only")
    smooth: Array = gaussian_filter1d(values, SMOOTH_S / period, mode="nearest")
    return smooth[edge:-edge]
