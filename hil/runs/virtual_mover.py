"""Move a loaded rig in virtual time: the same goals, the same bytes every time, on any machine."""

import numpy as np

from hil.rig.schema import RigConfig, RigError
from hil.runs.api import Run, columns_of, record_head
from hil.runs.mover import Mover
from hil.runs.rigs import Rig
from hil.virtual.goal_link import LockstepLink


class VirtualMover(Mover):
    """As Mover, of a rig and its emulated stage; time passes in its methods alone. It begins where the rig holds.

    Raises RigError where the rig cannot run, MotionError where it does not come to hold.
    """

    def __init__(self, rig: Rig) -> None:
        self._kept: list[bytes] = []
        try:
            self._simulated = LockstepLink(rig.config, rig.folder, self._keep)
        except ValueError as error:
            raise RigError([f"{rig.name}: {error}"]) from None
        super().__init__(self._simulated)

    @property
    def trace_sha256(self) -> str:
        """Over every frame sent and received so far."""
        return self._simulated.run.trace_sha256

    @property
    def config(self) -> RigConfig:
        """The rig that is simulated."""
        return self._simulated.rig

    @property
    def true_position(self) -> list[float]:
        """Where the emulated stage is, m (rad) by axis, whatever its encoders say."""
        places: list[float] = self._simulated.run.true_position.tolist()
        return places

    def run(self) -> Run:
        """The run so far, as columns."""
        return Run(self._simulated.rig, columns_of(self._kept, self._simulated.rig))

    def _keep(self, record: np.void) -> None:
        self._kept.append(record_head(record))
