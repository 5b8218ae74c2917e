"""Passes at constant speed, as the mean force over each place along the travel."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import gaussian_filter1d

from hil.identify.estimate import Array, Refused
from hil.identify.force_balance import CORNER_HZ, EDGE_S, about_samples, lagged

# Of the travel, left out at the beginning of a pass, as cables that move along take a way to turn; at most of the pass.
LEAD, MOST_LEAD = 0.08, 0.25
STALL_S = 0.05, 0.15  # left out before a stall, for the filter, and behind it, until the loop is at rest again
LEAST_SEEN = 0.1
PLACES = 240  # along the travel; the force is averaged over each
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
    ends = [end for one in passes for end in (one.position.min(), one.position.max())]
    low, high = min(ends), max(ends)
    edges = np.linspace(low, high, PLACES + 1)
    columns: list[list[Array]] = [[], [], [], [], []]
    for number, one in enumerate(passes):
        position, force = _smooth(one, period, mass, lag)
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


def _smooth(one: SpeedPass, period: float, mass: float, lag: float) -> tuple[Array, Array]:
    """Position and force less inertia, filtered alike; without the ends, where the filter has half its data."""
    width, edge = SMOOTH_S / period, round(EDGE_S / period)
    if one.position.size < 3 * edge:
        raise Refused(f"a pass at {one.speed:.3g} m/s is at constant speed for {one.position.size * period:.2g} s only")
    position = gaussian_filter1d(one.position, width, mode="nearest")
    force = gaussian_filter1d(about_samples(lagged(one.force, lag, period)), width, mode="nearest")
    force = force - mass * np.gradient(np.gradient(position, period), period)
    return position[edge:-edge], force[edge:-edge]
