"""The damped stop of STOPPING: brake towards rest on the filter's velocity, hold gravity, and be over in time."""

from collections.abc import Sequence

from hil.control.laws.base import Model

# Six of them fit into the default 50 ms; eight periods of a loop at 1 kHz, so that its delay does not matter.
TIME_CONSTANT_S = 0.008


class DampedStop:
    """Force = -mass * velocity / time constant, plus what holds the axis against gravity; lists, one float an axis."""

    def __init__(self, models: Sequence[Model], speed_limits: Sequence[float], period: float, stop_s: float) -> None:
        self._gains = [-model.mass / max(TIME_CONSTANT_S, 4.0 * period) for model in models]
        self._gravity = [model.gravity for model in models]
        self._rest = [1e-3 * limit for limit in speed_limits]
        self._stop_s = stop_s

    def force(self, velocity: Sequence[float]) -> list[float]:
        """Force asked for, N, at the given estimated velocities, m/s."""
        return [gain * v + gravity for gain, v, gravity in zip(self._gains, velocity, self._gravity, strict=True)]

    def over(self, velocity: Sequence[float], elapsed_s: float) -> bool:
        """Whether the axes are at rest, or the time allowed is up."""
        if elapsed_s < 0.2 * self._stop_s:
            return False
        return elapsed_s >= self._stop_s or all(abs(v) <= rest for v, rest in zip(velocity, self._rest, strict=True))
