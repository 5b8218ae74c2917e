"""What every trajectory is: a pure function of integer nanoseconds, bit-identical for one instant or many."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from hil.control.laws.base import Array, Reference

Times = NDArray[np.int64]
SMALL = 32  # values up to which plain floats beat array calls


class Trajectory(ABC):
    """Setpoints of all axes over task time.

    duration_ns: end of motion, None when it goes on for ever. steady_from_ns: statistics start here.
    repeat_ns: period of the motion after `repeat_from_ns`, None when it does not repeat. phase_names: what `phase_at`
    indexes.
    """

    duration_ns: int | None = None
    repeat_ns: int | None = None
    repeat_from_ns: int = 0
    steady_from_ns: int = 0
    phase_names: tuple[str, ...] = ("motion",)

    def __init__(self, n_axes: int) -> None:
        self._n = n_axes

    def sample(self, t_ns: Times) -> Reference:
        """Reference at task times `t_ns` (ns, int64, (..., n_axes), each axis at its own; below 0 counts as 0).

        Returns arrays (..., n_axes) in m, m/s, m/s^2 (rad for rotary axes), not shared with later calls.
        """
        if t_ns.size <= SMALL and t_ns.ndim <= 2:
            return self._sample_few(t_ns)
        out = np.empty((3, *t_ns.shape))
        clamped = np.maximum(t_ns, 0)
        for axis in range(self._n):
            out[0, ..., axis], out[1, ..., axis], out[2, ..., axis] = self._axis_array(axis, clamped[..., axis])
        return Reference(out[0], out[1], out[2])

    def _sample_few(self, t_ns: Times) -> Reference:
        rows = [[self.at(axis, t) for axis, t in enumerate(times)] for times in t_ns.reshape(-1, self._n).tolist()]
        values = np.array(rows).reshape(*t_ns.shape, 3)
        return Reference(values[..., 0].copy(), values[..., 1].copy(), values[..., 2].copy())

    def sample_axis(self, axis: int, t_ns: Times) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration of one axis at task times `t_ns` (ns, (...)), each (...)."""
        return self._axis_array(axis, np.maximum(t_ns, 0))

    def phase_at(self, t_ns: int) -> int:
        """Index into `phase_names` of the phase at task time `t_ns`."""
        return 0

    @abstractmethod
    def at(self, axis: int, t_ns: int) -> tuple[float, float, float]:
        """Position (m), velocity and acceleration of one axis at task time `t_ns`; below 0 counts as 0."""

    @abstractmethod
    def _axis_array(self, axis: int, t_ns: Times) -> tuple[Array, Array, Array]:
        """As `at` for many times; bit-identical to it."""


# A task that begins wherever the stage rests: its position by axis, m -> the trajectory from there. Little work however
# long the task, as it is called in the tick in which the drives have just been enabled.
Plan = Callable[[Sequence[float]], Trajectory]
