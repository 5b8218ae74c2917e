"""A rig in HOLD, in virtual time, that is asked for motion."""

from collections.abc import Callable

import numpy as np

from hil.cycle.goal import Goal, MotionWord
from hil.cycle.goal_desk import GoalDesk
from hil.cycle.limits import motion_limits
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.file import load_rig
from hil.virtual.lockstep import LockstepRun
from tests.support.paths import RIGS
from tests.support.records import kept

RIG = RIGS / "microscope-ideal.toml"
MS = 1_000_000
TASK = ["task.kind=circle", "task.axes=['x', 'y']", "task.radius=1e-3", "task.frequency_hz=1.0", "task.approach_s=0.5",
        "task.settle_s=0.0"]  # fmt: skip


class Held:
    """A rig in HOLD. rows: setpoint and acceleration bounds are read from the records of every tick."""

    def __init__(self, *changes: str, hold: bool = True, observer: Callable[..., None] | None = None) -> None:
        self.rig = load_rig(RIG, list(changes))
        kind = CommandKind.ACTIVATE_HOLD if hold else CommandKind.ACTIVATE
        self.records: list[np.void] = []
        self.accelerations: list[list[float]] = []
        self.observer = observer

        def observe(tick: object, frames: object, result: object) -> None:
            self.records.append(kept(result.record))  # type: ignore[attr-defined]
            self.accelerations.append([x.end.acceleration for x in self.run.cycle.inputs])
            if self.observer:
                self.observer(tick, frames, result)

        def asked(run: LockstepRun, tick: int) -> tuple[CommandKind, ...]:
            return (kind,) if run.cycle.state is State.READY and run.activated_at < 0 else ()

        self.run = LockstepRun(self.rig, RIGS, operator=asked, observer=observe)
        self.number = 0
        while self.desk.word is MotionWord.NONE:
            self.run.tick()
            assert self.run.index < 2_000

    @property
    def desk(self) -> GoalDesk:
        return self.run.cycle.supervisor.goals

    def ask(self, kind: int, *position: float, **more: object) -> int:
        """What refused it, 0: nothing."""
        self.number += 1
        places = (*position, *[0.0] * (4 - len(position)))
        self.run.goals.append(Goal(self.number, kind, position=places, **more))  # type: ignore[arg-type]
        self.run.tick()
        return int(self.records[-1]["goals"][0]["refusal"])

    def ticks(self, count: int) -> None:
        for _ in range(count):
            self.run.tick()

    def settle(self, most: int = 20_000) -> None:
        while self.desk.word is not MotionWord.HOLD:
            self.run.tick()
            most -= 1
            assert most

    @property
    def setpoint(self) -> list[float]:
        return [x.end.position for x in self.run.cycle.inputs]

    def hold_limits(self) -> None:
        """Every tick so far: no fault, limits kept, no step of the acceleration that is beyond the jerk."""
        assert self.run.cycle.state is State.ACTIVE
        found = np.array(self.accelerations)
        for axis, li in enumerate(motion_limits(self.rig)):
            q = np.array([record["setpoint_position"][axis] for record in self.records])
            v = np.array([record["setpoint_velocity"][axis] for record in self.records])
            assert li.low - 1e-9 <= q.min() <= q.max() <= li.high + 1e-9
            assert np.abs(v).max() <= li.speed * (1 + 1e-9)
            assert np.abs(found[:, axis]).max() <= li.acceleration * (1 + 1e-9)
            assert np.abs(np.diff(found[:, axis])).max() <= li.jerk * 1e-3 * (1 + 1e-6)
