"""Friction and forces along the travel from passes at constant speed, both ways.

What changes its sign with the direction is friction, what does not is a force of the place: gravity, cables, cogging.
The balance is linear but for the periods along the travel, which are searched.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import minimize_scalar

from hil.identify.estimate import Array, Estimate, Refused, jackknife
from hil.identify.force_balance import CORNER_HZ, lagged

LEAST_PASSES = 4
STEP_S = 0.02  # between the points used
PERIODS = 100  # tried
GAIN = 1.5  # by which a sinusoid along the travel must lower the residual's square to be told
LEAST_PARTS = 4.0  # periods are searched between 1.5 times the travel and the travel over this squared
SYSTEMATIC = {"coulomb": 0.002, "viscous": 0.02, "friction_variation": 0.03, "cogging_amplitude": 0.01}  # of the value:
# what the sinusoids and the cables' loop leave out, which no pass shows
UNEXPLAINED = 0.2  # of Coulomb friction, RMS, at most


class SpeedPass(NamedTuple):
    """One pass at constant speed, away from its ends: force as applied (N), position (m), (n,). speed: m/s, signed."""

    force: Array
    position: Array
    speed: float


class TravelFit(NamedTuple):
    """Estimates by quantity, what was refused, and the RMS force that is left, N."""

    found: dict[str, Estimate]
    refused: dict[str, str]
    residual: float


class _Points(NamedTuple):
    force: Array
    position: Array
    velocity: Array
    of_pass: Array


BASE = ("coulomb", "constant", "viscous", "cable_stiffness")


def travel_fit(passes: Sequence[SpeedPass], period: float, mass: float, lag: float = 0.0) -> TravelFit:
    """Coulomb and viscous friction, constant force, stiffness of cables, variation of friction and cogging along the
    travel; 95 % intervals from a jackknife over the passes. Raises Refused.
    """
    ways = [sum(p.speed > 0.0 for p in passes), sum(p.speed < 0.0 for p in passes)]
    if min(ways) < LEAST_PASSES // 2:
        raise Refused(f"{ways[0]} and {ways[1]} passes at constant speed in the two directions (at least 2 each)")
    speeds = [abs(p.speed) for p in passes]
    points = _points(passes, period, mass, lag)
    centre = 0.5 * float(points.position.min() + points.position.max())
    points = points._replace(position=points.position - centre)
    waves = _waves(points)
    x, rest = _solve(points, waves)
    residual = float(np.sqrt((rest**2).mean()))
    if x[0] <= 0.0 or residual > UNEXPLAINED * x[0]:
        raise Refused(f"{residual:.3g} N RMS left unexplained at a Coulomb friction of {x[0]:.3g} N (at most 20 %)")
    without = []
    for left_out in range(len(passes)):
        kept = points.of_pass != left_out
        part = _Points(*(values[kept] for values in points))
        shifted = [(kind, _refined(part, waves, i)) for i, (kind, _) in enumerate(waves)]
        y, _ = _solve(part, shifted)
        without.append(np.array([*_told(y, shifted).values()]))
    half = jackknife(without).tolist()
    refused = {}
    if max(speeds) < 1.5 * min(speeds):
        refused["viscous"] = f"one speed, {min(speeds):.3g} m/s: at least two that differ by half are needed"
    values = _told(x, waves)
    found = {
        name: Estimate(value, float(np.hypot(width, SYSTEMATIC.get(name, 0.0) * value)), UNITS[name])
        for (name, value), width in zip(values.items(), half, strict=True)
        if name not in refused
    }
    for kind, name in ((True, "friction_variation"), (False, "cogging_amplitude")):
        if not any(odd is kind for odd, _ in waves):
            refused[name] = f"no sinusoid along the travel above the residual of {residual:.2g} N"
    return TravelFit(found, refused, residual)


UNITS = {
    "coulomb": "N", "constant": "N", "viscous": "N s/m", "cable_stiffness": "N/m", "friction_variation": "1",
    "friction_period": "m", "cogging_amplitude": "N", "cogging_period": "m",
}  # fmt: skip


def _points(passes: Sequence[SpeedPass], period: float, mass: float, lag: float) -> _Points:
    """Filtered, less inertia, one every STEP_S."""
    width = np.sqrt(np.log(2.0)) / (2.0 * np.pi * CORNER_HZ * period)
    step, edge = round(STEP_S / period), round(0.03 / period)
    columns: list[list[Array]] = [[], [], [], []]
    for number, one in enumerate(passes):
        position = gaussian_filter1d(one.position, width, mode="nearest")
        velocity = np.gradient(position, period)
        force = gaussian_filter1d(lagged(one.force, lag, period), width, mode="nearest")
        force = force - mass * np.gradient(velocity, period)
        inside = slice(edge, len(position) - edge, step)
        values = (force[inside], position[inside], velocity[inside])
        for column, value in zip(columns, (*values, np.full(values[0].size, number)), strict=True):
            column.append(value)
    return _Points(*(np.concatenate(column) for column in columns))


def _design(points: _Points, waves: Sequence[tuple[bool, float]]) -> Array:
    """(k, n): BASE, then sine and cosine of every wave; a wave of friction (True) changes sign with the direction."""
    direction = np.sign(points.velocity)
    rows = [direction, np.ones_like(direction), points.velocity, points.position]
    for odd, length in waves:
        angle = 2.0 * np.pi * points.position / length
        factor = direction if odd else 1.0
        rows += [factor * np.sin(angle), factor * np.cos(angle)]
    return np.array(rows)


def _solve(points: _Points, waves: Sequence[tuple[bool, float]]) -> tuple[Array, Array]:
    a = _design(points, waves)
    size = np.sqrt((a * a).mean(axis=1))
    x, *_ = np.linalg.lstsq((a / size[:, None]).T, points.force, rcond=1e-9)
    return x / size, points.force - x @ (a / size[:, None])


def _square(points: _Points, waves: Sequence[tuple[bool, float]]) -> float:
    rest = _solve(points, waves)[1]
    return float(rest @ rest)


def _waves(points: _Points) -> list[tuple[bool, float]]:
    """The periods along the travel that are worth it: one of friction, one of the place."""
    travel = float(np.ptp(points.position))
    lengths = np.geomspace(travel / LEAST_PARTS**2, 1.5 * travel, PERIODS).tolist()
    waves: list[tuple[bool, float]] = []
    now = _square(points, waves)
    for _ in range(2):
        kinds = [odd for odd in (True, False) if all(odd is not other for other, _ in waves)]
        tried = [(_square(points, [*waves, (odd, length)]), odd, length) for odd in kinds for length in lengths]
        least, odd, length = min(tried)
        if least * GAIN > now:
            break
        waves.append((odd, length))
        for i in [*range(len(waves))] * 2:
            waves[i] = (waves[i][0], _refined(points, waves, i))
        now = _square(points, waves)
    return waves


def _refined(points: _Points, waves: Sequence[tuple[bool, float]], at: int) -> float:
    """The period of one wave where the residual is least, near the present one."""
    odd, length = waves[at]
    others = [wave for i, wave in enumerate(waves) if i != at]
    near = 0.04 * length
    found = minimize_scalar(
        lambda one: _square(points, [*others, (odd, float(one))]),
        bounds=(length - near, length + near),
        method="bounded",
        options={"xatol": 1e-4 * length},
    )
    return float(found.x)


def _told(x: Array, waves: Sequence[tuple[bool, float]]) -> dict[str, float]:
    """Quantities by name."""
    told = dict(zip(BASE, x.tolist(), strict=False))
    for i, (odd, length) in enumerate(waves):
        size = float(np.hypot(*x[4 + 2 * i : 6 + 2 * i]))
        if odd:
            told |= {"friction_variation": size / told["coulomb"], "friction_period": length}
        else:
            told |= {"cogging_amplitude": size, "cogging_period": length}
    return told
