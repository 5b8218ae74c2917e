"""The same goals to a rig in virtual time: each call advances the emulated rig by whole ticks, exactly."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from drivers.frame import Frame
from hil.analysis.feasibility import violations
from hil.analysis.task_figures import excursion_problems
from hil.cycle.goal import Goal, MotionError, MotionWord, Refusal
from hil.cycle.record import RECORD
from hil.cycle.tick import CommandKind, CycleResult, Tick
from hil.live.goal_link import FIELDS, Look, TickReader
from hil.rig.schema import RigConfig, TaskConfig
from hil.virtual.lockstep import LockstepRun, begin_when_ready

READY_S: Final = 60.0  # virtual time in which a rig must have come under torque


def _hold_when_ready(run: LockstepRun, index: int) -> Sequence[CommandKind]:
    return begin_when_ready(run, CommandKind.ACTIVATE_HOLD)


class LockstepLink:
    """A simulated rig that holds. Raises ValueError as LockstepRun, MotionError."""

    def __init__(self, rig: RigConfig, folder: Path, keep: Callable[[np.void], None]) -> None:
        """keep: called with the record of every tick, which is the same object each time."""
        self.rig = rig
        self._keep = keep
        self._number = 0
        self._reader = TickReader(rig)
        self._last = np.zeros(self._reader.ticks, [(name, RECORD[name]) for name in FIELDS])  # ticks, oldest first
        self._record = np.void(b"")
        self.run = LockstepRun(rig, folder, operator=_hold_when_ready, observer=self._observe)
        while self.run.cycle.supervisor.goals.word is MotionWord.NONE:
            self.run.tick()
            if self.run.index * rig.period_ns > READY_S * 1e9:
                look = self.look()
                raise MotionError(f"{rig.name} is {look.state.name}, fault {look.fault.name}, after {READY_S:g} s")

    def _observe(self, tick: Tick, frames: Sequence[Frame], result: CycleResult) -> None:
        self._record = result.record
        self._last[:-1] = self._last[1:]
        for name in FIELDS:
            self._last[-1][name] = result.record[name]
        self._keep(result.record)

    def take(self, *, by_force: bool = False) -> None:
        """Nobody else can reach a simulated rig."""

    def send(self, goal: Goal) -> tuple[int, Refusal]:
        """The next tick takes it."""
        self._number += 1
        self.run.goals.append(goal._replace(number=self._number, lease=1))
        self.run.tick()
        return self._number, Refusal(int(self._record["goals"][0]["refusal"]))

    def load_task(self, task: TaskConfig) -> None:
        """The next tick takes it. Raises RigError, ValueError as LockstepRun.load_task."""
        other = self.rig.model_copy(update={"task": task})
        found = [v.text() for v in violations(other, self.look().position)] + excursion_problems(other)
        if found:
            raise MotionError(f"the task cannot begin here: {found[0]}")
        self.run.load_task(task)
        self.run.tick()
        if not self.run.cycle.commands.handled[-1][1]:
            raise MotionError("a task is loaded while the axes hold, and by no law that learns from the rig's own")

    def look(self) -> Look:
        """The tick just run."""
        return self._reader.look(self._last)

    def now_ns(self) -> int:
        """Virtual time."""
        return self.run.index * self.rig.period_ns

    def wait(self, seconds: float) -> None:
        """Run the ticks of that time, at least one."""
        for _ in range(max(1, round(seconds * 1e9 / self.rig.period_ns))):
            self.run.tick()

    def leave(self) -> None:
        """It holds as long as ticks are run."""
