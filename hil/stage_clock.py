"""The control cycle with a clock at the seams between its stages.

The cycle itself reads no clock, so that lockstep and replay are exact; only the live shell wants to know where the time
goes, and wraps what it runs.
"""

from collections.abc import Callable
from pathlib import Path

from hil.cycle.step import ControlCycle
from hil.rig.schema import RigConfig


class TimedCycle(ControlCycle):
    """stamps: when the tick's estimate, control, gate and record began, on `clock` (ns); see hil.cycle.step.ESTIMATE
    ...
    """

    def __init__(self, rig: RigConfig, base_dir: Path, clock: Callable[[], int]) -> None:
        super().__init__(rig, base_dir)
        self.stamps = [0, 0, 0, 0]
        self._clock = clock

    def _mark(self, stage: int) -> None:
        self.stamps[stage] = self._clock()
