"""Where the search for resonances begins: one after the other, where it explains most of an axis' dynamic stiffness.

Force over position is, in continuous time, a sum: what accelerates the whole mass, viscous friction, and what each mass
on a spring takes beyond its own acceleration. With frequency and damping from a grid, only the masses are unknown, and
those are linear (orthogonal least squares: Chen, Billings, Luo, Int. J. Control 50(5), 1989).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.analysis.flexible_plant import AxisDynamics, hung
from hil.identify.estimate import Array

Complex = NDArray[np.complex128]
Mode = tuple[float, float, float]  # Hz on the held motor, damping ratio, part of the mass
LAGS = (0.5e-4, 1.5e-4, 2.5e-4, 4e-4, 8e-4)  # s, tried
GRID, DAMPINGS = 240, (0.005, 0.012, 0.03)  # frequencies, evenly from twice the first line to the last
AGAIN = 2  # times that each is chosen anew once another has come
LEAST_LOAD, MOST_LOAD = 0.005, 0.9  # of the mass, to begin with


class Stiffness:
    """Of a response (m/N, (k,)) at omega (rad/s, (k,)), sampled every `period` s, of an axis with that lag (s) of its
    force. mass: about the axis', kg. known: modes that it has.
    """

    def __init__(
        self, omega: Array, response: Complex, period: float, mass: float, lag: float, known: Sequence[Mode] = ()
    ) -> None:
        s = np.asarray(1j * omega, np.complex128)
        force = (1.0 - np.exp(-s * period)) / (s * period * (1.0 + lag * s))  # held, and behind
        folded = AxisDynamics(mass, lag).response(omega, period) - force / (mass * s * s)
        measured = force / (response - folded)
        self._weight = 1.0 / (np.abs(measured) + mass * omega**2)  # it is large at one resonance, small at the next
        self._mass, self._lag = mass, lag
        hertz = omega / (2.0 * np.pi)
        grid = np.linspace(2.0 * hertz[0], hertz[-1], GRID).tolist()
        self._grid: list[tuple[float, float]] = [(each, damping) for each, damping, _ in known]
        self._grid += [(each, damping) for each in grid for damping in DAMPINGS]
        self._known = len(known)
        self._hung = self._rows(np.array([hung(s, *each) - s * s for each in self._grid]))
        self._base, self._rest = self._rows(np.array([s * s, s])), self._rows(measured)

    def _rows(self, values: Complex) -> Array:
        weighted = values * self._weight
        return np.concatenate([weighted.real, weighted.imag], axis=-1)

    def axes(self, most: int) -> list[tuple[float, AxisDynamics]]:
        """With one mode beside the known ones, two, to `most`; before each, what it leaves of the stiffness."""
        chosen = list(range(self._known))
        found = []
        for more in range(most):
            chosen.append(self._next(chosen))
            for _ in range(AGAIN if more else 0):
                for place in range(self._known, len(chosen)):
                    chosen[place] = self._next(chosen[:place] + chosen[place + 1 :])
            found.append(self._axis(chosen))
        return found

    def _next(self, chosen: Sequence[int]) -> int:
        """Of the grid, what explains most beside those."""
        basis, _ = np.linalg.qr(np.vstack([self._base, self._hung[chosen]]).T)
        rest = self._rest - basis @ (basis.T @ self._rest)
        columns = self._hung - (self._hung @ basis) @ basis.T
        size = np.linalg.norm(columns, axis=1)
        size[size < 1e-9 * np.linalg.norm(self._hung, axis=1)] = np.inf  # chosen already
        return int(np.argmax(columns @ rest / size))

    def _axis(self, chosen: Sequence[int]) -> tuple[float, AxisDynamics]:
        columns = np.vstack([self._base, self._hung[chosen]]).T
        (mass, viscous, *hung), *_ = np.linalg.lstsq(columns, self._rest, rcond=None)
        left = float(np.linalg.norm(self._rest - columns @ np.array([mass, viscous, *hung])))
        mass = max(float(mass), 0.1 * self._mass)
        loads = [min(max(each / mass, LEAST_LOAD), MOST_LOAD) for each in hung]
        first, *others = [(*self._grid[at], load) for at, load in zip(chosen, loads, strict=True)]
        return left, AxisDynamics(mass, self._lag, *first, float(viscous))._replace(others=tuple(others))


def seeds(omega: Array, response: Complex, period: float, mass: float, most: int) -> list[list[AxisDynamics]]:
    """By number of modes less one: axes to begin with, the best first. As Stiffness; the lag is tried."""
    tried = [Stiffness(omega, response, period, mass, lag).axes(most) for lag in LAGS]
    return [[axis for _, axis in sorted(each, key=lambda one: one[0])] for each in zip(*tried, strict=True)]
