"""Axes on one flexure whose springs lean on each other: what pulls at one moves its neighbours, too."""

import numpy as np
from numpy.typing import NDArray

from hil import Plant, Truth

Array = NDArray[np.float64]  # (axes,)


class Leaning(Plant):
    """stiffness: N/m of every axis; lean: of it, what acts on each neighbour."""

    def __init__(self, truth: Truth, stiffness: float = 20.0, lean: float = 0.1) -> None:
        super().__init__(truth)
        self.stiffness, self.lean = stiffness, lean

    def acceleration(self, position: Array, velocity: Array, force: Array) -> Array:
        t = self.truth
        spring = self.stiffness * position
        others = self.lean * (np.sum(spring) - spring)
        friction = t.coulomb * velocity / (np.abs(velocity) + 1e-4) + t.viscous * velocity
        return (force + t.gravity - spring - others - friction) / t.mass
