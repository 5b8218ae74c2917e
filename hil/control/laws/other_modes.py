"""Resonances beside the first one: what they do in the observer, and what they take of the loop's speed.

Masses on springs hang on the motor beside the tool. In the observer (hil/control/laws/motion_observer.py) each is the
part of the encoder's motion against the centre of mass that its spring makes, and that part's rate. So the loop acts on
the centre of mass alone, and none of them is a tool that the law would follow. With load_i their parts of the mass, w_i
on the held motor, and the motor's own part 1 - sum(load_j):

    x_i'' = load_i / (1 - sum(load_j)) [(f - d) / m - sum(s_j)] - s_i,   s_i = w_i^2 x_i + 2 zeta_i w_i x_i'

Written for floats and arrays.
"""

from collections.abc import Sequence

from hil.control.laws.base import Model
from hil.control.laws.breakaway import anywhere
from hil.control.laws.presliding_gains import between, swings_of
from hil.control.number import Number, full_like, root, select, zeros_like

TURN = 6.283185307179586
TOOL = 3  # place of the tool's motion in the matrix; each has its rate behind it
FIRST = 7  # of these resonances: behind the state of the tool's axis and the force
# Noise of each, in times the root of its load, and how much slower the loop is: for a bandwidth of so many periods
# below the resonance. Where the model has no first mode, and at SWINGS; as usual, and of an axis that was measured.
NOISE = (45.0, (55.0, 37.5, 20.0, 20.0)), (25.0, (35.0, 25.0, 15.0, 15.0))
SLOWER = (1.4, (1.45, 1.9, 1.0, 0.6)), (0.6, (0.5, 0.75, 1.0, 0.8))
Mode = tuple[Number, Number, Number]  # Hz on the held motor, damping ratio, part of the mass; 0 Hz: none
Matrix = list[list[Number]]
Column = tuple[float, tuple[float, ...]]


def stated(model: Model) -> list[Mode]:
    """Those that any of the axes has."""
    none = zeros_like(model.mass)
    both = (
        (none + model.second_frequency, none + model.second_damping, none + model.second_load),
        (none + model.third_frequency, none + model.third_damping, none + model.third_load),
    )
    return [mode for mode in both if anywhere(mode[0] > 0.0)]


def with_others(axis: Matrix, tool: Mode, others: Sequence[Mode], period: float) -> Matrix:
    """Rates of the axis' state (7, 7), with two more rows and columns for each of the others; in periods, and in forces
    of 2 m / T^2. tool: w^2 and 2 zeta w on the held motor, in periods, and its part of the mass; 0: none.
    """
    zero = zeros_like(tool[0])
    whole, springs = tool[2], [tool]
    for hertz, ratio, load in others:
        turn = (TURN * period) * hertz
        whole = whole + load
        springs.append((turn * turn, 2.0 * ratio * turn, select(hertz > 0.0, load, zero)))
    n = FIRST + 2 * len(others)
    rates = [row + [zero] * (n - FIRST) for row in axis] + [[zero] * n for _ in range(n - FIRST)]
    there = whole > tool[2]
    for i, (stiff, damped, load) in enumerate(springs):
        place = FIRST + 2 * (i - 1) if i else TOOL
        part = load / (1.0 - whole)
        row = [zero] * n
        row[2], row[5] = 2.0 * part, -2.0 * part
        for k, (spring, damper, _) in enumerate(springs):
            column = FIRST + 2 * (k - 1) if k else TOOL
            row[column], row[column + 1] = -part * spring, -part * damper
        row[place], row[place + 1] = row[place] - stiff, row[place + 1] - damped
        rates[place][place + 1] = zero + 1.0
        rates[place + 1] = [select(there, now, before) for now, before in zip(row, rates[place + 1], strict=True)]
    return rates


class Springs:
    """They over one period: m, and m a period. transition: (7 + 2 n, 7 + 2 n), of `with_others`. metre: m that a
    constant force of 1 N moves the axis by in a period.
    """

    def __init__(self, transition: Matrix, metre: Number, period: float) -> None:
        rows = transition[FIRST:]
        self.states = len(rows)
        self._own = [row[FIRST:] for row in rows]
        self._by_tool = [(row[TOOL], row[TOOL + 1] * period) for row in rows]
        self._by_force = [(row[2] * metre, row[6] * metre, -row[5] * metre) for row in rows]
        self._on_motion = transition[TOOL][FIRST:]
        self._on_rate = [value / period for value in transition[TOOL + 1][FIRST:]]

    @property
    def by_lagged(self) -> list[Number]:
        """What a newton behind the lag makes of them."""
        return [lagged for lagged, _, _ in self._by_force]

    def moved(
        self, states: Sequence[Number], x: Number, n: Number, forces: tuple[Number, Number, Number]
    ) -> list[Number]:
        """A period on. x, n: the tool's motion (m) and its rate (m/s). forces: behind the lag, before it, and the
        disturbance, N.
        """
        lagged, force, opposing = forces
        found = []
        for row, (by_x, by_n), (by_lagged, by_force, against) in zip(
            self._own, self._by_tool, self._by_force, strict=True
        ):
            value = by_x * x + by_n * n + (by_lagged * lagged + by_force * force - against * opposing)
            found.append(value + _sum(row, states))
        return found

    def on_motion(self, states: Sequence[Number]) -> Number:
        """What they add to the tool's motion in a period, m."""
        return _sum(self._on_motion, states)

    def on_rate(self, states: Sequence[Number]) -> Number:
        """Likewise to its rate, m/s."""
        return _sum(self._on_rate, states)


def motion(states: Sequence[Number]) -> Number:
    """What the encoder sees of them all; 0 of none."""
    found: Number = 0.0
    for value in states[::2]:
        found = found + value
    return found


def corrected(states: Sequence[Number], gains: Sequence[Number], innovation: Number) -> list[Number]:
    """With what an innovation says of them."""
    return [state + gain * innovation for state, gain in zip(states, gains, strict=True)]


def noises(model: Model, period: float) -> list[Number]:
    """Of each, in motion, as MotionModel.gains takes the first mode's."""
    times = _of(NOISE, model, period)
    return [times * root(load) for _, _, load in stated(model)]


def slowed(own: dict[str, Number], model: Model, period: float) -> dict[str, Number]:
    """The law's own gains, with what these resonances take of the loop's speed; its observer slows down as it does."""
    slower, bandwidth = _of(SLOWER, model, period), own["bandwidth"]
    lost = zeros_like(bandwidth)
    for hertz, _, load in stated(model):
        there = hertz > 0.0
        near = bandwidth / select(there, hertz * period, zeros_like(hertz) + 1.0)
        lost = lost + select(there, slower * root(root(load)) * (near * root(near)), zeros_like(lost))
    left = 1.0 / (1.0 + lost)
    cube = left * left * left
    times = {
        "bandwidth": left, "force_noise": left * left, "disturbance_noise": cube, "rest_bandwidth": left,
        "rest_force_noise": left * left, "rest_disturbance_noise": cube, "integral": left, "table_delay": 1.0 / left,
        "innovation_noise": 1.0 / cube,
    }  # fmt: skip
    for name, factor in times.items():
        own[name] = own[name] * factor
    return own


def _sum(weights: Sequence[Number], states: Sequence[Number]) -> Number:
    found: Number = 0.0
    for weight, state in zip(weights, states, strict=True):
        found = found + weight * state
    return found


def _of(columns: tuple[Column, Column], model: Model, period: float) -> Number:
    swings, known = swings_of(model, period), full_like(model.mass, model.known)
    usual, measured = [
        select(swings > 0.0, between(flexible, swings), zeros_like(swings) + rigid) for rigid, flexible in columns
    ]
    return usual + known * (measured - usual)
