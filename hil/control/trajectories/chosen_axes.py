"""Some axes of a trajectory: for studies that simulate these alone."""

from collections.abc import Sequence

from hil.control.laws.base import Array
from hil.control.trajectories.base import Times, Trajectory


class ChosenAxes(Trajectory):
    """The axes `kept` (0-based) of `whole`, in this order."""

    def __init__(self, whole: Trajectory, kept: Sequence[int]) -> None:
        super().__init__(len(kept))
        self._whole, self._kept = whole, list(kept)
        self.repeat_ns, self.repeat_from_ns = whole.repeat_ns, whole.repeat_from_ns

    def at(self, axis: int, t_ns: int) -> tuple[float, float, float]:
        """See Trajectory."""
        return self._whole.at(self._kept[axis], t_ns)

    def _axis_array(self, axis: int, t_ns: Times) -> tuple[Array, Array, Array]:
        return self._whole.sample_axis(self._kept[axis], t_ns)
