"""Forces that no drive makes, besides gravity: white noise and a random walk.

One source for floats and arrays (number.py).
"""

from sim_plant.physics.noise import TORQUE, WALK, Key, Stream
from sim_plant.physics.number import Number, root


class Disturbance:
    """Of one axis (floats) or of many (arrays)."""

    def __init__(self, density: Number, walk: Number, seed: Key, axis: Key) -> None:
        """density: N/sqrt(Hz), one-sided. walk: N/sqrt(s)."""
        self._density = density
        self._walk = walk
        self._torque = Stream(seed, axis, TORQUE)
        self._steps = Stream(seed, axis, WALK)

    def parameters(self) -> list[Number]:
        """Density and walk, as given."""
        return [self._density, self._walk]

    def keys(self) -> tuple[int, int]:
        """Of one axis: the keys of its streams of noise and walk."""
        return self._torque.key, self._steps.key

    def draw(self, walked: Number, count: int, h: float) -> tuple[Number, Number]:
        """Force during piece `count`, which is h seconds long, and how far the walk is then (N)."""
        span: Number = root(h)
        walked = walked + self._walk * span * self._steps.at(count)
        return walked + self._density / root(2.0 * h) * self._torque.at(count), walked
