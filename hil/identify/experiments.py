"""The experiments that identify an axis: one list for lockstep runs and, later, for the rig.

Each is a path of [task] and gains of hil/identify/excitation.py, both functions of task time alone; what one experiment
finds is a parameter of the next. Each ends at rest and stays within the limits of the rig file.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hil.cycle.limits import oscillation_limit
from hil.cycle.oscillation import LONGEST_SWING_S, SMALL
from hil.identify.estimate import Array
from hil.identify.excitation import (
    BANDWIDTH_HZ,
    GROWING,
    MULTISINE,
    PERIOD_S,
    TRIANGLES,
    Excitation,
    multisine_motion,
)
from hil.rig.law_names import EXPERIMENT
from hil.rig.schema import AxisConfig, RigConfig

ROW_S = 0.01  # of a path
RAMP_S = 0.15  # from rest to speed
REST_S = 0.3  # at both ends of an experiment
SWEEP_REACH, PASS_REACH, STRETCH_REACH = 0.7, 0.45, 0.6  # of half the travel
STRETCH_S = 0.6, 2.5  # a pass over the stretch at the greatest and the least speed, about
SPEED_SHARE = 0.4  # of limits.speed
SWEEP_S = 3.0
MINIMUM_JERK_PEAK = 1.875  # greatest over mean speed
STRETCH_SPEEDS = 6
FIRST_PUSH = 0.002  # of limits.force
EXCURSION, EXCURSION_COUNTS = {"linear": 20e-6, "rotary": 1e-4}, 10  # m, rad: of a push, and its least
PUSH_HZ, PUSH_S = 4.0, 9.0
HOLD_HZ = 25.0  # of the loop that catches a weight: gravity may be 30 % wrong
LOOP_HZ, LOOP_CYCLES = 2.5, 21
LOOPS = (1.3, 0.1)  # of Coulomb friction, first and last: the first leaves the bristle in a known state
LINE_SHARE = 0.06  # of Coulomb friction, each line of the multisine, at most
SWING_SHARE = 0.1  # of limits.oscillation, RMS that the multisine moves the axis by, at most
# Of a pass' speed, the greatest that the multisine adds: friction must not turn, though the mass be 1.7 times too big.
PEAK_SHARE = 0.5
COMMISSIONED = 10.0  # tolerance of [axes.NAME.push]: signs and scales are still seen, though the model is to be found
TURN_S = 0.15  # at rest between passes: else the swings of one and the turn behind it count as an oscillation
SETTLE_S = 0.28  # of a pass at speed, before its periods
SHORTER = 0.07  # of the reach, by which each way of the passes ends before the last
PASS_PERIODS, PASSES, PASSES_EACH_WAY = 2, 12, 4
CHECK_SHARE = 0.2  # of limits.speed: friction that varies along the travel must not shake the loose loop
WAVE_SHARE = 0.8  # of the slowest oscillation's frequency, that of friction's waves then
CHECK_S, SHORT_MOVES, SHORT_SHARE, SHORT_S = 4.0, 4, 0.1, 0.3  # sine; number of moves, size over the sine's, s of each


@dataclass(frozen=True)
class Known:
    """What the experiments so far have found of an axis; SI. mass: at first the rig file's."""

    mass: float
    gravity: float = 0.0
    coulomb: float = 0.0
    friction_variation: float = 0.0
    friction_period: float = 0.0


NOTHING: Mapping[str, Known] = {}


@dataclass
class Plan:
    """One axis in one experiment. rows: positions (n,), one every ROW_S from the first; gains of the law; spans:
    (from, until) in s of task time at constant speed, with their speed (m/s); approach_s comes before the first row.
    """

    positions: Array
    gains: dict[str, float]
    spans: list[tuple[float, float, float]] = field(default_factory=list)


def middle(axis: AxisConfig) -> tuple[float, float]:
    """Centre of the travel and half of it, m."""
    low, high = axis.limits.position
    return 0.5 * (low + high), 0.5 * (high - low)


def _held(axis: AxisConfig, seconds: float) -> Array:
    return np.full(math.ceil(seconds / ROW_S) + 1, middle(axis)[0])


def _gains(axis: AxisConfig, known: Known, **others: float) -> dict[str, float]:
    excursion = max(EXCURSION[axis.kind], EXCURSION_COUNTS * axis.encoder_resolution)
    own = {"mass": known.mass, "gravity": known.gravity, "coulomb": known.coulomb, "excursion": excursion}
    return own | others


def push(axis: AxisConfig, known: Known, approach_s: float) -> Plan:
    """Hold, then triangles of force that grow until the axis moves by 20 um."""
    begin = approach_s + 1.5
    hold_hz = HOLD_HZ if axis.model.gravity else 0.0
    gains = _gains(axis, known, shape=GROWING, amplitude=FIRST_PUSH * axis.limits.force, frequency_hz=PUSH_HZ,
                   from_s=begin, until_s=begin + PUSH_S, hold_hz=hold_hz)  # fmt: skip
    return Plan(_held(axis, 1.5 + PUSH_S + REST_S), gains)


def loops(axis: AxisConfig, known: Known, approach_s: float) -> Plan:
    """Triangles of force from beyond Coulomb friction down to a tenth of it."""
    begin, lasts = approach_s + 1.0, LOOP_CYCLES / LOOP_HZ
    first, last = (min(share * known.coulomb, 0.8 * axis.limits.force) for share in LOOPS)
    gains = _gains(axis, known, shape=TRIANGLES, amplitude=last, amplitude_from=first, frequency_hz=LOOP_HZ,
                   from_s=begin, until_s=begin + lasts)  # fmt: skip
    return Plan(_held(axis, 1.0 + lasts + REST_S), gains)


def moves(axis: AxisConfig, known: Known, approach_s: float) -> Plan:
    """Sweeps of the usable travel both ways at two speeds, then six speeds both ways over the same stretch."""
    centre, half = middle(axis)
    most = SPEED_SHARE * axis.limits.speed
    reach = SWEEP_REACH * half
    slow = min(2.0 * reach / SWEEP_S, 0.5 * most)
    path = _Passes(centre, SPEED_SHARE * axis.limits.speed)
    for speed in (slow, 2.0 * slow):
        path.pass_between(-reach, reach, speed)
        path.pass_between(reach, -reach, speed)
    fastest_s, slowest_s = STRETCH_S
    stretch = min(0.5 * most * fastest_s, STRETCH_REACH * half)
    fastest = min(most, 2.0 * stretch / fastest_s)
    for speed in np.geomspace(2.0 * stretch / slowest_s, fastest, STRETCH_SPEEDS).tolist():
        path.pass_between(-stretch, stretch, speed)
        path.pass_between(stretch, -stretch, speed)
    path.go_to(0.0)
    return Plan(path.rows(), _gains(axis, known), path.spans_from(approach_s))


def frequency(axis: AxisConfig, known: Known, approach_s: float) -> Plan:
    """Passes at constant speed with a multisine; its sign changes after every two passes.

    Two passes take whole periods of it, so that those of opposite sign meet the same forces along the travel at the
    same instants of it, and their difference is without them. Later passes go another way: what friction along the
    travel makes of the multisine differs then, and is seen.
    """
    centre, half = middle(axis)
    lasts = SETTLE_S + PASS_PERIODS * PERIOD_S + 2 * ROW_S + RAMP_S
    speed = min(2.0 * PASS_REACH * half / lasts, SPEED_SHARE * axis.limits.speed)
    path = _Passes(centre, SPEED_SHARE * axis.limits.speed)
    reach = 0.5 * speed * lasts
    path.go_to(-reach)
    lead = path.seconds
    for number in range(PASSES):
        end = reach * (1.0 - SHORTER * (number // PASSES_EACH_WAY))
        speed = (reach + end) / lasts
        path.pass_between(*((-reach, end), (end, -reach))[number % 2], speed)
        path.rest(TURN_S)
    each = (path.seconds - lead) / PASSES
    path.go_to(0.0)
    begin = approach_s + lead
    way, peak = multisine_motion(known.mass)
    swings, turns = SWING_SHARE * oscillation_limit(axis.limits) / way, PEAK_SHARE * speed / peak
    gains = _gains(axis, known, shape=MULTISINE, amplitude=min(LINE_SHARE * known.coulomb, swings, turns), from_s=begin,
                   until_s=begin + PASSES * each, alternate_s=2.0 * each)  # fmt: skip
    return Plan(path.rows(), gains, path.spans_from(approach_s))


def check(axis: AxisConfig, known: Known, approach_s: float) -> Plan:
    """What no other experiment does: a sine at 1 Hz that comes and goes, and short moves."""
    centre, half = middle(axis)
    speed = min(CHECK_SHARE * axis.limits.speed, _speed_of_slow_waves(axis, known))
    size = min(PASS_REACH * half, speed / (2.0 * math.pi))
    seconds = np.arange(round(CHECK_S / ROW_S) + 1) * ROW_S
    grown = np.sin(0.5 * math.pi * np.clip(np.minimum(seconds, CHECK_S - seconds), 0.0, 1.0)) ** 2
    path = _Passes(centre, SPEED_SHARE * axis.limits.speed)
    path.follow(size * grown * np.sin(2.0 * math.pi * seconds))
    for number in range(SHORT_MOVES):
        path.go_to((1, -1)[number % 2] * SHORT_SHARE * size, SHORT_S)
        path.rest(TURN_S)
    path.go_to(0.0, SHORT_S)
    return Plan(path.rows(), _gains(axis, known))


def _speed_of_slow_waves(axis: AxisConfig, known: Known) -> float:
    """At which friction that varies along the travel passes too slowly for its swings to count as an oscillation, m/s;
    inf where it swings the loose loop too little to count.
    """
    swing = known.friction_variation * known.coulomb / (known.mass * (2.0 * math.pi * BANDWIDTH_HZ) ** 2)
    if swing < SMALL * oscillation_limit(axis.limits):
        return math.inf
    return WAVE_SHARE * known.friction_period / (2.0 * LONGEST_SWING_S)


EXPERIMENTS = {"push": push, "frequency": frequency, "moves": moves, "loops": loops, "check": check}


class _Passes:
    """A path of passes at constant speed, about a centre, in steps of ROW_S. most: greatest speed, m/s."""

    def __init__(self, centre: float, most: float) -> None:
        self._centre, self._most, self._positions = centre, most, [0.0]
        self._spans: list[tuple[float, float, float]] = []
        self.rest(REST_S)

    @property
    def seconds(self) -> float:
        """Of the path so far."""
        return (len(self._positions) - 1) * ROW_S

    def rest(self, seconds: float) -> None:
        """Stay."""
        self._positions += [self._positions[-1]] * math.ceil(seconds / ROW_S)

    def follow(self, positions: Array) -> None:
        """From rest to rest, from where it is."""
        self._positions += positions.tolist()

    def go_to(self, target: float, least_s: float = 1.0) -> None:
        """From rest to rest, at no more than the greatest speed and for `least_s` at least; minimum jerk."""
        here = self._positions[-1]
        n = math.ceil(max(least_s, MINIMUM_JERK_PEAK * abs(target - here) / self._most) / ROW_S)
        u = np.arange(1, n + 1) / n
        self._positions += (here + (target - here) * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)).tolist()

    def pass_between(self, begin: float, end: float, speed: float) -> None:
        """From rest at `begin` to rest at `end`; goes to `begin` first where it is elsewhere."""
        if abs(self._positions[-1] - begin) > 1e-12:
            self.go_to(begin)
        ramp = math.ceil(RAMP_S / ROW_S)
        way = abs(end - begin)
        cruise = max(round((way / speed - ramp * ROW_S) / ROW_S), 1)
        u = (np.arange(ramp) + 0.5) / ramp
        rise = u * u * (3.0 - 2.0 * u)
        rates = np.concatenate([rise, np.ones(cruise), rise[::-1]])
        rates *= way / rates.sum()
        first = self.seconds + ramp * ROW_S
        self._positions += (begin + np.sign(end - begin) * np.cumsum(rates)).tolist()
        actual = float(np.sign(end - begin) * rates.max() / ROW_S)
        self._spans.append((first, first + cruise * ROW_S, actual))

    def spans_from(self, start_s: float) -> list[tuple[float, float, float]]:
        """The spans at constant speed, in task time."""
        return [(start_s + a, start_s + b, speed) for a, b, speed in self._spans]

    def rows(self) -> Array:
        """All positions, with a rest at the end."""
        self.rest(REST_S)
        return self._centre + np.array(self._positions)


def rig_document(
    rig: RigConfig, name: str, plan: Plan, approach_s: float, found: Mapping[str, Known] = NOTHING
) -> tuple[dict[str, Any], float]:
    """The rig's document with this plan of one axis as its task and law, and the s of task time it lasts. The other
    axes rest. found: of those that were identified before.
    """
    rows = [[k * ROW_S, float(position)] for k, position in enumerate(plan.positions)]
    each = [plan.gains if other == name else _resting(axis, found.get(other)) for other, axis in rig.axes.items()]
    document = rig.model_dump(mode="json")
    document["task"] = {"kind": "path", "axes": [name], "samples": rows, "approach_s": approach_s, "settle_s": 0.0,
                        "between": "blended"}  # fmt: skip
    gains = {key: [one.get(key, Excitation.GAINS[key].default) for one in each] for key in sorted(set().union(*each))}
    for axis in document["axes"].values():
        if axis["push"]:
            axis["push"]["tolerance"] = COMMISSIONED
    document["law"] = {"name": EXPERIMENT, "gains": gains}
    return document, approach_s + len(rows) * ROW_S


def _resting(axis: AxisConfig, found: Known | None) -> dict[str, float]:
    """Gains of an axis that rests: a weight that nobody has measured yet needs the stiffer loop."""
    stiffer = {"hold_hz": HOLD_HZ} if axis.model.gravity else {}
    return stiffer if found is None else stiffer | {"mass": found.mass, "gravity": found.gravity}
