"""Friction and forces along the travel from passes at constant speed, both ways.

What changes its sign with the direction is friction, what does not is a force of the place: gravity, cables, cogging.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hil.identify.curved_friction import Curved, Line, curved
from hil.identify.estimate import WIDEST, Array, Estimate, Refused, damping, jackknife
from hil.identify.places import PLACES, Points, SpeedPass, points_of, seen, shown
from hil.identify.waves import BASE, design, refined, searched, solve, waves_force, waves_seen, within_travel

LEAST_PASSES = 4
# Shares of the value: what the sinusoids and the cables' loop leave out, which no pass shows.
SYSTEMATIC = {
    "coulomb": 0.001, "viscous": 0.015, "quadratic": 0.015, "friction_variation": 0.03, "friction_period": 0.001,
    "cogging_amplitude": 0.01, "cogging_period": 0.006,
}  # fmt: skip
UNSEEN = 3.0  # times these, where friction may vary along the travel and no sinusoid was told
LONG_WAVE = 3.0  # times these for a period as long as the travel, of which cables and the ends take their part
PHASE = 0.015  # rad, the same of a sinusoid's phase
SHAKEN = 3  # times that shaking is allowed for, each time by the waves that were found behind the last
UNEXPLAINED = 0.2  # of Coulomb friction, RMS, at most


class TravelCurves(NamedTuple):
    """To look at: along the travel (n,) m, the friction and the force of the place, less what changes with speed, N. By
    pass (k,) the speed, m/s, and the friction at it, N. viscous: N s/m, negative where friction falls throughout;
    curved: the part of friction beside it that is no straight line over speed, if any.
    """

    position: Array
    friction: Array
    place: Array
    speed: Array
    friction_at_speed: Array
    viscous: float
    curved: Curved | None = None


class TravelFit(NamedTuple):
    """Estimates by quantity, what was refused, the RMS force that is left, N, and what it was found from."""

    found: dict[str, Estimate]
    refused: dict[str, str]
    residual: float
    curves: TravelCurves


def travel_fit(
    passes: Sequence[SpeedPass], period: float, mass: float, lag: float = 0.0, rounding: float = 0.0
) -> TravelFit:
    """Coulomb and viscous friction, constant force, stiffness of cables, variation of friction and cogging along the
    travel; 95 % intervals from a jackknife over the passes. rounding: N, by which frames may change a force; it counts
    where no noise is larger. Raises Refused.
    """
    ways = [sum(p.speed > 0.0 for p in passes), sum(p.speed < 0.0 for p in passes)]
    if min(ways) < LEAST_PASSES // 2:
        raise Refused(f"{ways[0]} and {ways[1]} passes at constant speed in the two directions (at least 2 each)")
    pass_speeds = [p.speed for p in passes]
    speeds = [abs(speed) for speed in pass_speeds]
    points = points_of(passes, period, mass, lag)
    centre = 0.5 * float(points.position.min() + points.position.max())
    points = points._replace(position=points.position - centre)
    refused = {}
    if max(speeds) < 1.5 * min(speeds):
        refused["viscous"] = f"one speed, {min(speeds):.3g} m/s: at least two that differ by half are needed"
    fit = _over_speed_and_travel(passes, period, points, centre, sloped=not refused)
    points, waves, x, bent = fit.points, fit.waves, fit.x, fit.bent
    residual = float(np.sqrt((fit.rest**2).mean()))
    if x[0] <= 0.0 or residual > UNEXPLAINED * x[0]:
        raise Refused(f"{residual:.3g} N RMS left unexplained at a Coulomb friction of {x[0]:.3g} N (at most 20 %)")
    without = []
    for left_out in range(len(passes)):
        kept = points.of_pass != left_out
        part, even = (Points(*(values[kept] for values in each)) for each in (points, fit.flat))
        bent_too = bent.of(even, pass_speeds) if bent else None
        other = 0.0 if refused else bent_too.viscous if bent_too else _viscous(even)
        part = _without_speed(part, other, bent_too)
        shifted = refined(part, waves)
        y, _ = solve(part, shifted)
        told = (*_told(y, shifted, points, -centre).values(), *_drift(part, shifted, y).values())
        without.append(np.array([other, bent_too.drag if bent_too else 0.0, *told]))
    values = {
        "viscous": fit.viscous,
        "quadratic": bent.drag if bent else 0.0,
        **_told(x, waves, points, -centre),
        **_drift(fit.level, waves, x),
    }
    half = jackknife(_unwrapped(without, values)).tolist()
    travel = float(np.ptp(points.position))
    systematic = _systematic(values, travel)
    if residual < rounding:
        spread = {"viscous": max(speeds) - min(speeds), "coulomb": 1.0, "constant": 1.0}
        systematic |= {name: math.hypot(systematic[name], rounding / size) for name, size in spread.items() if size}
    found = {
        name: Estimate(value, float(np.hypot(width, systematic.get(name, 0.0))), UNITS[name])
        for (name, value), width in zip(values.items(), half, strict=True)
        if name not in refused
    }
    if not found["quadratic"].value:
        del found["quadratic"]
    _allow_for(fit.over, found, refused)
    for kind, name, period_of in WAVES:
        length = next((length for odd, length in waves if odd is kind), None)
        if length is None:
            refused[name] = f"no sinusoid along the travel above the residual of {residual:.2g} N"
        elif length > travel:
            refused[name] = f"its period is longer than the travel of {travel:.3g} m"
            refused["cable_stiffness"] = f"{name} looks like it: {refused[name]}"
            found.pop("cable_stiffness", None)
        if name in refused:
            for gone in (name, period_of, period_of.replace("period", "phase")):
                found.pop(gone, None)
    hidden = x @ (design(fit.level, waves, blurred=False) - design(fit.level, waves))
    whole = fit.level._replace(force=fit.level.force + hidden)
    curves = _curves(whole, centre, fit.rest, pass_speeds, float(x[0]), fit.viscous, bent)
    return TravelFit(found, refused, residual, curves)


def _systematic(values: Mapping[str, float], travel: float) -> dict[str, float]:
    """Half widths of what no pass shows."""
    unseen = 1.0 if "friction_period" in values or "cogging_period" in values else UNSEEN
    off = {name: unseen * share * values[name] for name, share in SYSTEMATIC.items() if name in values}
    off |= {name: PHASE for name in values if name.endswith("_phase")}
    for name in off:
        if name.endswith("_period"):
            off[name] *= max(1.0, LONG_WAVE * values[name] / travel)
    off["constant"] = SYSTEMATIC["coulomb"] * values["coulomb"]  # the sinusoids' ends go into either
    return off


def _allow_for(over: Curved | Line, found: dict[str, Estimate], refused: dict[str, str]) -> None:
    """Widen Coulomb and viscous friction by what the speeds do not tell of them, or refuse them."""
    coulomb = found["coulomb"].value
    if isinstance(over, Curved) and "friction_variation" in found:  # does the curved part vary along the travel, too?
        wave = found["friction_variation"]
        off = abs(wave.value * float(over.at(np.zeros(1))[0]) / coulomb)
        found["friction_variation"] = wave._replace(half_width=math.hypot(wave.half_width, off))
    for name, off in (("coulomb", over.coulomb_off), ("viscous", over.viscous_off)):
        if name not in found:
            continue
        found[name] = one = found[name]._replace(half_width=math.hypot(found[name].half_width, off))
        if isinstance(over, Curved) and one.half_width >= WIDEST * abs(one.value):
            del found[name]
            told = f"{one.value:.3g} +- {one.half_width:.2g} {one.unit} by the speeds passed (at most {WIDEST:.0%})"
            if not math.isfinite(one.half_width):
                told = f"about {one.value:.3g} {one.unit}, and nobody knows it beyond the speeds passed"
            refused[name] = f"friction {over.words}: {told}"
    if "viscous" in found:
        try:
            found["viscous"] = damping(found["viscous"])
        except Refused as negative:
            del found["viscous"]
            refused["viscous"] = negative.reason


WAVES = ((True, "friction_variation", "friction_period"), (False, "cogging_amplitude", "cogging_period"))
UNITS = {
    "coulomb": "N", "constant": "N", "viscous": "N s/m", "quadratic": "N s^2/m^2", "cable_stiffness": "N/m",
    "friction_variation": "1", "friction_period": "m", "friction_phase": "rad",
    "cogging_amplitude": "N", "cogging_period": "m", "cogging_phase": "rad", "position_drift": "m",
}  # fmt: skip


def _unwrapped(without: Sequence[Array], values: Mapping[str, float]) -> list[Array]:
    """Phases as near to the whole fit's as whole turns allow."""
    phases = np.array([name.endswith("_phase") for name in values])
    whole = np.array(list(values.values()))
    return [np.where(phases, whole + np.angle(np.exp(1j * (each - whole))), each) for each in without]


def _curves(
    points: Points, centre: float, rest: Array, speeds: Sequence[float], coulomb: float, viscous: float,
    bent: Curved | None,
) -> TravelCurves:  # fmt: skip
    """Of places that were passed both ways."""
    at, rows = points.place.astype(int), []
    for place in range(PLACES):
        up, down = ((at == place) & (points.velocity * way > 0.0) for way in (1.0, -1.0))
        if up.any() and down.any():
            f, g = points.force[up].mean(), points.force[down].mean()
            rows.append((centre + points.position[up][0], 0.5 * (f - g), 0.5 * (f + g)))
    left = [float(rest[points.of_pass == number].mean()) for number in range(len(speeds))]
    moved = [coulomb + viscous * abs(v) + float(np.sign(v)) * each for v, each in zip(speeds, left, strict=True)]
    position, friction, place_force = np.array(rows).reshape(-1, 3).T
    at_speed = np.array(moved) + (bent.at(np.array(speeds)) if bent else 0.0)
    return TravelCurves(position, friction, place_force, np.array(speeds), at_speed, viscous, bent)


class _Fit(NamedTuple):
    """What changes with speed, and along the travel. points: as they were at constant speed; of these, level: less what
    changes with speed; flat: less the waves.
    """

    viscous: float
    over: Curved | Line
    waves: list[tuple[bool, float]]
    x: Array
    rest: Array
    points: Points
    level: Points
    flat: Points

    @property
    def bent(self) -> Curved | None:
        """The part that is no straight line over speed."""
        return self.over if isinstance(self.over, Curved) else None


def _over_speed_and_travel(
    passes: Sequence[SpeedPass], period: float, raw: Points, centre: float, *, sloped: bool
) -> _Fit:
    """Waves shake a loose axis, which is slow where friction is great. Of their force such passes show another share
    than passes at constant speed: it is told by the waves found, and taken out. Waves longer than the travel shake
    nothing, and nobody knows how large they are. sloped: friction over speed is told.
    """
    points, flat, travel = raw, raw, float(np.ptp(raw.position))
    waves: list[tuple[bool, float]] = []
    for number in range(1 + SHAKEN):
        over = curved(flat, [p.speed for p in passes]) if sloped else Line()
        bent = over if isinstance(over, Curved) else None
        viscous = 0.0 if not sloped else bent.viscous if bent else _viscous(flat)
        level = _without_speed(points, viscous, bent)
        waves = refined(level, waves) if number else searched(level)
        x, rest = solve(level, waves)
        shaking, sizes = within_travel(waves, x, travel)
        if not shaking:
            break
        flat = raw._replace(force=raw.force - shown(passes, period, waves_force(shaking, sizes, centre)))
        points = raw._replace(force=flat.force + waves_seen(raw, shaking, sizes))
    return _Fit(viscous, over, waves, x, rest, points, level, flat)


def _viscous(points: Points) -> float:
    """By how much the force grows with speed, N s/m: compared at the same place and in the same direction, where all
    else is the same whatever it is.
    """
    group = 2 * points.place.astype(int) + (points.velocity > 0.0)
    size = np.maximum(np.bincount(group), 1)

    def varied(values: Array) -> Array:
        mean: Array = np.bincount(group, values) / size
        rest: Array = values - mean[group]
        return rest

    speed = varied(points.velocity)
    return float(speed @ varied(points.force) / (speed @ speed))


def _without_speed(points: Points, viscous: float, bent: Curved | None) -> Points:
    force = points.force - viscous * points.velocity
    return points._replace(force=force - np.sign(points.velocity) * bent.at(points.velocity) if bent else force)


def _told(x: Array, waves: Sequence[tuple[bool, float]], points: Points, zero: float) -> dict[str, float]:
    """Quantities by name; friction and force of the place as their means over the travel of all passes, the waves'
    phases at the axis' zero.
    """
    told = dict(zip(BASE, x.tolist(), strict=False))
    low, high = float(points.position.min()), float(points.position.max())
    for i, (odd, length) in enumerate(waves):
        at, turn = len(BASE) + 2 * i, 2.0 * np.pi / length
        sine, cosine = x[at : at + 2].tolist()
        size = float(np.hypot(sine, cosine))
        phase = math.remainder(math.atan2(cosine, sine) + zero * turn, 2.0 * math.pi)
        if odd:
            told |= {"friction_variation": size / told["coulomb"], "friction_period": length, "friction_phase": phase}
        else:
            told |= {"cogging_amplitude": size, "cogging_period": length, "cogging_phase": phase}
        ends = np.array([low, high]) * turn
        mean = sine * float(np.diff(-np.cos(ends))[0]) + cosine * float(np.diff(np.sin(ends))[0])
        told["coulomb" if odd else "constant"] += mean / (turn * (high - low))
    return told


def _drift(points: Points, waves: Sequence[tuple[bool, float]], x: Array) -> dict[str, float]:
    """By how far the waves moved along the travel from the first pass to the last, m: the scale slips, or a tool grows
    warm. Friction and constant force may change meanwhile. Without waves nothing tells it.
    """
    if not waves:
        return {}
    base = design(points, waves)
    slope = np.zeros(points.position.size)
    for i, (odd, length) in enumerate(waves):
        turn, (sine, cosine) = 2.0 * np.pi / length, x[len(BASE) + 2 * i :][:2]
        steep = turn * (sine * np.cos(turn * points.position) - cosine * np.sin(turn * points.position))
        steep *= seen(points, length)
        slope += steep * base[0] if odd else steep
    part = points.of_pass / max(points.of_pass.max(), 1)
    a = np.vstack([base, part, part * base[0], -part * slope])
    size = np.sqrt((a * a).mean(axis=1))
    told, *_ = np.linalg.lstsq((a / size[:, None]).T, points.force, rcond=1e-9)
    return {"position_drift": float(told[-1] / size[-1])}
