"""An adaptive Runge-Kutta 5(4) solver as simulation tools ship it: what such a solver adds to the paper's figures.

Dormand and Prince, J. Comput. Appl. Math. 6 (1980), with the step control of the ode45 family. It holds the largest
component of the error estimate, relative to the larger of its values before and after the step, floored at atol / rtol
(Shampine and Reichelt, SIAM J. Sci. Comput. 18, 1997). scipy's RK45 is the same pair with a root-mean-square norm,
which lets a single component err about twice as much (3.4 instead of 1.7 um on Y here).
"""

from collections.abc import Callable

import numpy as np

from hil.control.laws.base import Array

_NODES = (0.2, 0.3, 0.8, 8 / 9, 1.0, 1.0)
_WEIGHTS = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
_ERROR = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)
_ORDER = 0.2  # exponent of the step control
_LARGEST_STEP = 0.1  # of the whole interval


def solve(
    slope: Callable[[float, Array], Array],
    start: Array,
    duration: float,
    rtol: float,
    atol: float,
    progress: Callable[[float], None] | None = None,
) -> tuple[Array, Array]:
    """Times (n,) and states (n, d) of all accepted steps from 0 to `duration` s."""
    floor = atol / rtol
    t, y = 0.0, start.copy()
    k = [slope(t, y)]
    h = min(_LARGEST_STEP * duration, 0.8 * rtol**_ORDER / max(1e-12, _norm(k[0], y, y, floor)))
    times, states = [t], [y]
    while t < duration:
        failed = False
        while True:
            h = min(max(h, 1e-15 * (t + 1.0)), _LARGEST_STEP * duration, duration - t)
            new, k = _step(slope, t, y, k[0], h)
            error = h * _norm(sum(w * ki for w, ki in zip(_ERROR, k, strict=True)), y, new, floor)  # type: ignore[arg-type]
            if error <= rtol:
                break
            h *= 0.5 if failed else max(0.1, 0.8 * (rtol / error) ** _ORDER)
            failed = True
        t, y = t + h, new
        k = [k[6]]  # the last stage is the first of the next step
        times.append(t)
        states.append(y)
        if not failed:
            h /= max(0.2, 1.25 * (error / rtol) ** _ORDER)
        if progress and len(times) % 1000 == 0:
            progress(t / duration)
    return np.array(times), np.array(states)


def _norm(vector: Array, before: Array, after: Array, floor: float) -> float:
    return float(np.max(np.abs(vector) / np.maximum(np.maximum(np.abs(before), np.abs(after)), floor)))


def _step(
    slope: Callable[[float, Array], Array], t: float, y: Array, first: Array, h: float
) -> tuple[Array, list[Array]]:
    """State after h, and the seven slopes."""
    k = [first]
    new = y
    for node, weights in zip(_NODES, _WEIGHTS, strict=True):
        new = y.copy()
        for weight, ki in zip(weights, k, strict=True):
            new += (h * weight) * ki
        k.append(slope(t + node * h, new))
    return new, k
