"""A rose with some petals, drawn once and ended at rest where it began."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil import Task


class Rose(Task):
    """Radius of a petal in m, number of petals (odd), duration in s."""

    def __init__(self, axes: Sequence[str], radius: float = 5e-3, petals: int = 3, seconds: float = 4.0) -> None:
        if len(axes) != 2:
            raise ValueError(f"a rose needs two axes, not {axes}")
        self.radius, self.petals, self.seconds = radius, petals, seconds

    def samples(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        time = np.linspace(0.0, self.seconds, 401)
        u = time / self.seconds
        angle = np.pi * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)  # from 0 to pi, at rest at both ends
        distance = self.radius * np.sin(self.petals * angle)
        return time, np.column_stack([distance * np.cos(angle), distance * np.sin(angle)])
