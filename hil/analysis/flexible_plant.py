"""One axis as a linear plant with what real stages have: lag of the force, flexible modes, the stiffness it hangs on.

States per axis: force behind its command, motor's error and rate, tool's error and rate, then error and rate of each
further mass on a spring. A force is held over each period, so the step from sample to sample is exact (matrix
exponential).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.control.laws.base import Array

_STATES = 5
_FORCE, _MOTOR, _RATE, _TOOL, _TOOL_RATE = range(_STATES)
_TERMS = 14  # 0.5^15 / 15! is below the rounding of 1


def exponential(matrix: Array) -> Array:
    """e^matrix, of (n, n): Taylor's series of a 2^k th with a norm below 0.5, squared k times.

    Source: Moler and Van Loan, SIAM Review 45(1), 2003, method 3. Here, as scipy has it too, but every control process
    calculates one before it starts, and would hold 117 MB of scipy locked in memory for that. The observer's own
    (motion_observer.py) is for lists of floats or arrays in compiled code, and too coarse for poles this near to 1.
    """
    squarings = max(0, 1 + int(np.frexp(np.abs(matrix).sum(axis=1).max())[1]))
    small = matrix * 0.5**squarings
    result = term = np.eye(len(matrix))
    for k in range(1, _TERMS + 1):
        term = term @ small / k
        result = result + term
    for _ in range(squarings):
        result = result @ result
    return result


class AxisDynamics(NamedTuple):
    """mass: kg, all that moves. lag: s. mode_hz: at which the tool rings while the motor is held, 0: rigid;
    mode_damping: ratio; mode_load: the tool's part of the mass. viscous: N s/m. stiffness, damping: of what holds the
    motor where it is, N/m and N s/m. others: further masses that hang on the motor, (Hz on the held motor, damping
    ratio, part of the mass) of each.
    """

    mass: float
    lag: float = 0.0
    mode_hz: float = 0.0
    mode_damping: float = 0.0
    mode_load: float = 0.0
    viscous: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    others: tuple[tuple[float, float, float], ...] = ()

    @property
    def states(self) -> int:
        """How many there are."""
        return _STATES + 2 * len(self.others)

    def with_others(self, count: int) -> "AxisDynamics":
        """The same axis with places for so many further masses; those it does not have weigh nothing."""
        return self._replace(others=self.others + ((0.0, 0.0, 0.0),) * (count - len(self.others)))

    def step_matrices(self, period: float) -> tuple[Array, Array]:
        """x(k+1) = a x(k) + b u(k): a (states, states), b (states,)."""
        n = self.states
        a, b = np.zeros((n, n)), np.zeros(n)
        tool = (self.mode_hz, self.mode_damping, self.mode_load)
        hung = [mode for mode in (tool, *self.others) if mode[0]]
        motor = self.mass - sum([load * self.mass for _, _, load in hung])
        if self.lag:
            a[_FORCE, _FORCE], b[_FORCE] = -1.0 / self.lag, 1.0 / self.lag
            a[_RATE, _FORCE] = 1.0 / motor
        else:
            b[_RATE] = 1.0 / motor
        a[_MOTOR, _RATE] = a[_TOOL, _TOOL_RATE] = 1.0
        a[_RATE, _MOTOR] = -self.stiffness / motor
        a[_RATE, _RATE] = -(self.viscous + self.damping) / motor
        for place, (hertz, ratio, part) in zip(range(_TOOL, n, 2), (tool, *self.others), strict=True):
            a[place, place + 1] = 1.0
            if not hertz:
                continue
            omega, load = 2.0 * np.pi * hertz, part * self.mass
            spring, damper = load * omega * omega, 2.0 * ratio * load * omega
            for row, mass in ((_RATE, motor), (place + 1, -load)):
                a[row, _MOTOR] -= spring / mass
                a[row, place] += spring / mass
                a[row, _RATE] -= damper / mass
                a[row, place + 1] += damper / mass
        whole = np.zeros((n + 1, n + 1))
        whole[:n, :n], whole[:n, n] = a, b
        step = exponential(whole * period)
        return step[:n, :n], step[:n, n]

    def response(self, omega: Array, period: float, delay: float = 0.0) -> NDArray[np.complex128]:
        """Motor position over force, m/N, at `omega` (rad/s, (k,)), sampled, with the hold: complex (k,).

        delay: s, between the force and what is told of the position, besides the lag; any sign. A part of a period
        shifts the samples (modified z-transform: Jury, Theory and Application of the z-Transform Method, 1964).
        """
        a, b = self.step_matrices(period)
        z = np.exp(1j * omega * period)
        shifted = z[:, None, None] * np.eye(b.size) - a
        state = np.linalg.solve(shifted, np.broadcast_to(b[:, None], (z.size, b.size, 1)))[..., 0]
        ticks = np.ceil(delay / period)
        on, driven = self.step_matrices(ticks * period - delay)
        answer: NDArray[np.complex128] = (state @ on[_MOTOR] + driven[_MOTOR]) * z**-ticks
        return answer


def hung(s: NDArray[np.complex128], frequency: Array | float, damping: float) -> NDArray[np.complex128]:
    """Force over the position of what carries 1 kg on a spring, N/m."""
    omega = 2.0 * np.pi * frequency
    spring = 2.0 * damping * omega * s + omega * omega
    force: NDArray[np.complex128] = s * s * spring / (s * s + spring)
    return force


class FlexiblePlant:
    """A hil.analysis.pulse_loop.Plant of one AxisDynamics per row and axis."""

    def __init__(self, rows: list[list[AxisDynamics]], period: float) -> None:
        most = max([len(axis.others) for row in rows for axis in row])
        alike = [[axis.with_others(most) for axis in row] for row in rows]
        made = {axis: axis.step_matrices(period) for row in alike for axis in row}
        self._a = np.array([[made[axis][0] for axis in row] for row in alike])
        self._b = np.array([[made[axis][1] for axis in row] for row in alike])
        self._state = np.zeros(self._b.shape)

    @property
    def error(self) -> Array:
        """The motor's, m, at the sample."""
        error: Array = self._state[..., _MOTOR]
        return error

    @property
    def rate(self) -> Array:
        """The motor's, m/s."""
        rate: Array = self._state[..., _RATE]
        return rate

    def advance(self, force: Array) -> None:
        """On by one period."""
        self._state = (self._a @ self._state[..., None])[..., 0] + self._b * force[..., None]

    def place(self, error: Array, rate: Array) -> None:
        """Begin there, all masses alike, without force."""
        self._state[:] = 0.0
        self._state[..., _MOTOR::2] = error[..., None]
        self._state[..., _RATE::2] = rate[..., None]
