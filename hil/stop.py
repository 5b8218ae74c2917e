"""The damped stop of STOPPING: brake towards rest on the filter's velocity, hold gravity, and be over in time."""

import numpy as np

from hil.laws.base import Array, Model

TIME_CONSTANT_S = (
    0.008  # six of them fit into the default 50 ms; eight periods of the loop, so the delay does not matter
)


class DampedStop:
    """Force = -mass * velocity / time constant, plus what holds the axis against gravity; arrays (n_axes,)."""

    def __init__(self, model: Model, speed_limit: Array, period: float, stop_s: float) -> None:
        self._gain = -model.mass / max(TIME_CONSTANT_S, 4.0 * period)
        self._gravity = model.gravity
        self._rest = 1e-3 * speed_limit
        self._stop_s = stop_s
        self._force: Array = np.zeros_like(model.mass)

    def force(self, velocity: Array) -> Array:
        """Force asked for, N, at the given estimated velocity, m/s."""
        np.multiply(self._gain, velocity, out=self._force)
        np.add(self._force, self._gravity, out=self._force)
        return self._force

    def over(self, velocity: Array, elapsed_s: float) -> bool:
        """Whether the axes are at rest, or the time allowed is up."""
        return elapsed_s >= self._stop_s or (
            elapsed_s >= 0.2 * self._stop_s and bool((abs(velocity) <= self._rest).all())
        )
