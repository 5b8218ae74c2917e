"""Circle and Lissajous figure, entered by a minimum-jerk blend from wherever the stage stands."""

from collections.abc import Mapping, Sequence
from fractions import Fraction

import numpy as np

from hil.control.laws.base import Array
from hil.control.number import Number
from hil.control.trajectories.base import Times, Trajectory
from hil.control.trajectories.minimum_jerk import Motion, entered
from sim_plant.physics.exact_trigonometry import TURN, sincos_turns, sincos_turns_array

SECOND = 1_000_000_000  # ns
INT64_LIMIT = 2**62


class Oscillation:
    """amplitude * cos(2 pi (frequency t + offset)); offset in turns.

    cycle: (p, m), so that the phase is (p t mod m) / m turns for t in ns, in exact integers. speed, acceleration:
    amplitudes of the derivatives. Worked out once: each tick asks for them, and to divide fractions takes microseconds.
    """

    def __init__(self, amplitude: float, frequency_hz: Fraction, offset: float) -> None:
        exact, omega = frequency_hz / SECOND, TURN * float(frequency_hz)
        self.amplitude = amplitude
        self.frequency_hz = frequency_hz
        self.offset = offset
        self.cycle: tuple[int, int] = (exact.numerator, exact.denominator)
        self.speed = amplitude * omega
        self.acceleration = self.speed * omega


def rational_hz(frequency_hz: float) -> Fraction:
    """The decimal fraction meant by a frequency, coarsened only where 64-bit phase arithmetic would overflow."""
    limit = 1_000_000
    while True:
        fraction = Fraction(repr(float(frequency_hz))).limit_denominator(limit)
        cycle = fraction / SECOND
        if cycle.numerator * cycle.denominator < INT64_LIMIT:
            return fraction
        limit //= 10


class Figure(Trajectory):
    """Some axes oscillate, the others hold; q = start + s(t) (figure(t) - start), s minimum jerk over `approach_ns`.

    From s = 1 on it is the figure itself; position, velocity and acceleration are continuous at the join.
    """

    phase_names: tuple[str, ...] = ("approach", "figure")

    def __init__(
        self, oscillations: Mapping[int, Oscillation], start: Sequence[float], approach_ns: int, settle_ns: int
    ) -> None:
        super().__init__(len(start))
        self._start = list(start)
        self._oscillations = dict(oscillations)
        self._approach_ns = approach_ns
        self._per_second = 1e9 / approach_ns  # du/dt
        self.repeat_from_ns = approach_ns
        self.steady_from_ns = approach_ns + settle_ns
        slowest = min(o.frequency_hz for o in self._oscillations.values())
        self.repeat_ns = round(SECOND / slowest)

    def phase_at(self, t_ns: int) -> int:
        """0 while approaching, 1 on the figure."""
        return int(t_ns >= self._approach_ns)

    def at(self, axis: int, t_ns: int) -> tuple[float, float, float]:
        """See Trajectory."""
        oscillation = self._oscillations.get(axis)
        if oscillation is None:
            return self._start[axis], 0.0, 0.0
        t_ns = t_ns if t_ns > 0 else 0  # a third of what max() costs
        p, m = oscillation.cycle
        sine, cosine = sincos_turns((t_ns % m * p % m) / m + oscillation.offset)
        figure = self._derivatives(oscillation, sine, cosine)
        if t_ns >= self._approach_ns:
            return figure
        return entered(self._start[axis], figure, t_ns / self._approach_ns, self._per_second)

    def _axis_array(self, axis: int, t_ns: Times) -> tuple[Array, Array, Array]:
        oscillation = self._oscillations.get(axis)
        if oscillation is None:
            zero = np.zeros(t_ns.shape)
            return np.full(t_ns.shape, self._start[axis]), zero, zero
        p, m = oscillation.cycle
        sine, cosine = sincos_turns_array((t_ns % m * p % m) / m + oscillation.offset)
        figure: tuple[Array, Array, Array] = self._derivatives(oscillation, sine, cosine)
        u = np.minimum(t_ns, self._approach_ns) / self._approach_ns
        blended: tuple[Array, Array, Array] = entered(self._start[axis], figure, u, self._per_second)
        done = t_ns >= self._approach_ns
        return (
            np.where(done, figure[0], blended[0]),
            np.where(done, figure[1], blended[1]),
            np.where(done, figure[2], blended[2]),
        )

    @staticmethod
    def _derivatives(oscillation: Oscillation, sine: Number, cosine: Number) -> Motion:
        return oscillation.amplitude * cosine, -oscillation.speed * sine, -oscillation.acceleration * cosine


def turns(phase_rad: float) -> float:
    """Radians as turns."""
    return phase_rad / TURN


def circle_oscillations(
    first: int, second: int, radius: float, frequency_hz: float, phase: float
) -> dict[int, Oscillation]:
    """The paper's q_d = [cos(2 pi f t), sin(2 pi f t)] of the given radius; `phase` (rad) advances both."""
    frequency, offset = rational_hz(frequency_hz), turns(phase)
    return {first: Oscillation(radius, frequency, offset), second: Oscillation(radius, frequency, offset - 0.25)}


def lissajous_oscillations(
    first: int, second: int, radius: float, frequency_hz: float, ratio: int, phase: float
) -> dict[int, Oscillation]:
    """cos(2 pi f t + phase) on the first axis, sin(ratio 2 pi f t) on the second."""
    frequency = rational_hz(frequency_hz)
    return {first: Oscillation(radius, frequency, turns(phase)), second: Oscillation(radius, frequency * ratio, -0.25)}
