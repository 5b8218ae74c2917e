"""A stage between two hard stops, for homing against one: springs with dampers, and smooth dry friction."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil import Plant

Array = NDArray[np.float64]
STIFFNESS = 2e5  # N/m
DAMPING = 40.0  # N s/m
CREEP = 1e-5  # m/s, over which the friction turns


class Walled(Plant):
    """low, high: places of the stops, m."""

    def __init__(self, truth: Any, low: float = -0.02, high: float = 0.02) -> None:
        super().__init__(truth)
        self.low, self.high = low, high

    def acceleration(self, position: Array, velocity: Array, force: Array) -> Array:
        deep = np.minimum(position - self.low, 0.0) + np.maximum(position - self.high, 0.0)
        pushed = np.where(deep != 0.0, STIFFNESS * deep + DAMPING * velocity, 0.0)
        pushed = np.where(pushed * deep > 0.0, pushed, 0.0)
        friction = self.truth.coulomb * np.tanh(velocity / CREEP) + self.truth.viscous * velocity
        found: Array = (force - pushed - friction + self.truth.gravity) / self.truth.mass
        return found
