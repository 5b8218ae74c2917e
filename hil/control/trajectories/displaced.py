"""A trajectory that goes somewhere else on one axis: what the fault campaign gives the cycle instead of the task."""

import numpy as np

from hil.control.laws.base import Array
from hil.control.trajectories.base import Times, Trajectory


class Displaced(Trajectory):
    """`honest`, displaced by `position` (m) and `velocity` (m/s) on one of `n_axes` axes; they need not agree."""

    def __init__(self, honest: Trajectory, n_axes: int, axis: int, position: float, velocity: float) -> None:
        super().__init__(n_axes)
        self._honest, self._axis, self._position, self._velocity = honest, axis, position, velocity
        self.duration_ns, self.steady_from_ns = honest.duration_ns, honest.steady_from_ns
        self.repeat_ns, self.repeat_from_ns = honest.repeat_ns, honest.repeat_from_ns
        self.phase_names = honest.phase_names

    def phase_at(self, t_ns: int) -> int:
        """See Trajectory."""
        return self._honest.phase_at(t_ns)

    def at(self, axis: int, t_ns: int) -> tuple[float, float, float]:
        """See Trajectory."""
        position, velocity, acceleration = self._honest.at(axis, t_ns)
        if axis != self._axis:
            return position, velocity, acceleration
        return position + self._position, velocity + self._velocity, acceleration

    def _axis_array(self, axis: int, t_ns: Times) -> tuple[Array, Array, Array]:
        rows = np.array([self.at(axis, t) for t in t_ns.ravel().tolist()])
        position, velocity, acceleration = rows.T.reshape(3, *t_ns.shape)
        return position, velocity, acceleration
