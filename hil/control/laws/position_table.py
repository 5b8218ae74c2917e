"""A force learnt over the travel, one table for each direction of motion: what repeats with the position.

Friction that varies along a guide, cogging and a cable's pull differ from place to place, and the two directions differ
by twice the friction. Piecewise linear over evenly spaced nodes, about position 0; the outermost nodes hold beyond.
"""

from typing import Any

import numpy as np

from hil.control.number import Number, bounded, select, zeros_like

HALF = 31  # nodes on each side of position 0
LAST_CELL = 30.999
NODES = 2 * HALF + 1


class PositionTable:
    """Of one axis (floats), or of many (arrays of one shape). pitch: distance of the nodes, m. limit: of a value, N."""

    def __init__(self, pitch: Number, limit: Number) -> None:
        self._density = 1.0 / pitch
        self._limit = limit
        self._floats = isinstance(limit, float)
        self._values: Any = [0.0] * NODES if self._floats else np.zeros((NODES, *np.shape(limit)))
        self._axes: Any = () if self._floats else tuple(np.indices(np.shape(limit), sparse=True))  # beside the node
        zero = zeros_like(limit)
        self._to_near, self._to_far = zero, zero  # learnt since the axis came between the nodes beside it
        _, self._near, self._far = self._place(zero)

    def _place(self, position: Number) -> tuple[Number, Any, Any]:
        """Share of the way from one node to the next, away from position 0, and both nodes' numbers."""
        signed = bounded(position * self._density, LAST_CELL)
        place = abs(signed)
        if self._floats:
            cell = int(place)
            step = 1 if signed >= 0.0 else -1
            return place - cell, HALF + step * cell, HALF + step * (cell + 1)
        array: Any = place
        cells = array.astype(np.int64)
        steps = np.where(signed >= 0.0, 1, -1)
        return place - cells, HALF + steps * cells, HALF + steps * (cells + 1)

    def at(self, position: Number) -> Number:
        """Force learnt there, N."""
        share, near, far = self._place(position)
        low, high = self._read(near), self._read(far)
        return low + (high - low) * share

    def add(self, position: Number, force: Number) -> None:
        """Let the force there grow by about `force` (N), once the axis has left the nodes beside it.

        At once, it would act on what is still ahead in the same pass, and be learnt from again.
        """
        share, near, far = self._place(position)
        was_near, was_far, to_near, to_far = self._near, self._far, self._to_near, self._to_far
        left_near, left_far = (was_near != near) & (was_near != far), (was_far != near) & (was_far != far)
        if not self._floats or left_near or left_far:
            zero = zeros_like(force)
            self._grow(was_near, select(left_near, to_near, zero))
            self._grow(was_far, select(left_far, to_far, zero))
            self._to_near = select(near == was_near, to_near, select(near == was_far, to_far, zero))
            self._to_far = select(far == was_near, to_near, select(far == was_far, to_far, zero))
            self._near, self._far = near, far
        self._to_near = self._to_near + (1.0 - share) * force
        self._to_far = self._to_far + share * force

    def values(self) -> list[Number]:
        """Of all nodes, N, from the most negative position on."""
        return [self._values[node] for node in range(NODES)]

    def fill(self, values: list[Number]) -> None:
        """Begin with these, N."""
        for node in range(NODES):
            self._values[node] = bounded(values[node], self._limit)

    def _grow(self, node: Any, force: Number) -> None:
        self._write(node, bounded(self._read(node) + force, self._limit))

    def _read(self, node: Any) -> Number:
        value: Number = self._values[node] if self._floats else self._values[(node, *self._axes)]
        return value

    def _write(self, node: Any, value: Number) -> None:
        self._values[node if self._floats else (node, *self._axes)] = value
