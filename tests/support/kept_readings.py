"""A run in lockstep, and the readings of its first sensor by tick."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from drivers.frame import Frame
from hil.cycle.state_machine import State
from hil.cycle.tick import CycleResult, Tick
from hil.rig.schema import RigConfig
from hil.virtual.lockstep import LockstepRun
from sim_plant.scenario.language import Scenario
from tests.support.paths import RIGS
from tests.support.records import kept


class Kept:
    """rows: records. sent: all frames. folder: what the rig's files are relative to."""

    def __init__(self, rig: RigConfig, folder: Path = RIGS, *, scenario: Scenario | None = None) -> None:
        self.rows: list[np.void] = []
        self.sent: list[Frame] = []
        self.run = LockstepRun(rig, folder, observer=self._observe, scenario=scenario)

    def _observe(self, tick: Tick, frames: Sequence[Frame], result: CycleResult) -> None:
        self.rows.append(kept(result.record))
        self.sent += result.frames

    def ticks(self, count: int) -> Self:
        """So many more."""
        for _ in range(count):
            self.run.tick()
        return self

    def until_active(self) -> Self:
        """As many as it takes, below 1500."""
        while self.run.cycle.state is not State.ACTIVE:
            assert self.ticks(1).run.index < 1500
        return self

    @property
    def values(self) -> Any:
        """Readings, in the sensor's unit."""
        return np.array([row["readings"][0] for row in self.rows])

    @property
    def ages(self) -> Any:
        """Of the readings, ticks."""
        return np.array([row["reading_age"][0] for row in self.rows])
