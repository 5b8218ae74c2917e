"""A force learnt over the travel, one table for each direction of motion: what repeats with the position.

Friction that varies along a guide, cogging and a cable's pull differ from place to place, and the two directions differ
by twice the friction. Piecewise linear over evenly spaced nodes, about position 0; the outermost nodes hold beyond.
"""

from typing import Any

import numpy as np

from hil.control.number import Number, at_least, bounded

HALF = 31  # nodes on each side of position 0
LAST_CELL = 61.999


class PositionTable:
    """Of one axis (floats), or of many (arrays of one shape). pitch: distance of the nodes, m. limit: of a value, N."""

    def __init__(self, pitch: Number, limit: Number) -> None:
        self._density = 1.0 / pitch
        self._limit = limit
        self._floats = isinstance(limit, float)
        self._values: Any = [0.0] * (2 * HALF + 1) if self._floats else np.zeros((2 * HALF + 1, *np.shape(limit)))

    def _place(self, position: Number) -> Number:
        """Position in cells from the first node."""
        return at_least(bounded(position * self._density + HALF, LAST_CELL), 0.0)

    def at(self, position: Number) -> Number:
        """Force learnt there, N."""
        place = self._place(position)
        values = self._values
        if self._floats:
            cell = int(place)
            low: float = values[cell]
            high: float = values[cell + 1]
            return low + (high - low) * (place - cell)
        cells = place.astype(np.int64)[None]
        first = np.take_along_axis(values, cells, 0)[0]
        return first + (np.take_along_axis(values, cells + 1, 0)[0] - first) * (place - cells[0])

    def add(self, position: Number, force: Number) -> None:
        """Let the force there grow by about `force` (N)."""
        place = self._place(position)
        values = self._values
        if self._floats:
            cell = int(place)
            share = place - cell
            low: float = values[cell]
            high: float = values[cell + 1]
            values[cell] = bounded(low + (1.0 - share) * force, self._limit)
            values[cell + 1] = bounded(high + share * force, self._limit)
            return
        cells = place.astype(np.int64)[None]
        share = place - cells[0]
        for at, more in ((cells, (1.0 - share) * force), (cells + 1, share * force)):
            new = bounded(np.take_along_axis(values, at, 0)[0] + more, self._limit)
            np.put_along_axis(values, at, new[None], 0)
