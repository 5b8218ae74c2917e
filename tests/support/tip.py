"""A rig whose tip goes down into something, run tick by tick in virtual time."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import hil
from drivers.protocols.base import DriveStatus
from hil.cycle.limits import motion_limits
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.events.event import Event
from hil.events.sources import events_of
from hil.events.table import Kind
from hil.rig.file import load_rig
from hil.virtual.lockstep import LockstepRun
from tests.support import told_motion
from tests.support.paths import RIGS
from tests.support.records import kept

RIG = RIGS / "microscope-ideal.toml"
INSIDE = f"motion.name={Path(told_motion.__file__)}:Inside"
OUTPUT = "outputs.valve={can_id=0x3E0, bit=0, longest_s=9}"
SENSOR = '{{can_id={:#x}, unit="N", scale=1e-8, noise=5e-6, range=[-0.01, 0.01]}}'
SAFE, DEEP, SPEED, PERIOD = -0.001, -0.002, 0.01, 1e-3
X, Z = 0, 2
Answer = Callable[[hil.Observation], Any]


def down(seen: hil.Observation) -> hil.References:
    """Along z to DEEP at SPEED, and to stay there; the valve open."""
    before = seen.reference[Z][0]
    speed = max(seen.reference[Z][1] - 2e-5, -SPEED) if before > DEEP + 0.002 * SPEED else 0.0
    place = max(before + 0.5 * (seen.reference[Z][1] + speed) * PERIOD, DEEP)
    return hil.References([0.0, 0.0, place, 0.0], [0.0, 0.0, speed, 0.0], outputs=1, phase=3)


class TipRun:
    """A run whose tip goes down into something. rows: its records; told: its events; says: for the next tick."""

    def __init__(self, answer: Answer = down, *changes: str) -> None:
        self.rig = load_rig(RIG, ("task.kind=hold", INSIDE, OUTPUT, *changes))
        self.rows: list[np.void] = []
        self.told: list[Event] = []
        self.says: list[CommandKind] = []
        self._events = events_of(self.rig)

        def observe(tick: object, frames: object, result: Any) -> None:
            self.rows.append(kept(result.record))
            self.told += self._events.observe(self.run.cycle, result.record)

        self.run = LockstepRun(self.rig, RIGS, observer=observe, operator=lambda run, tick: self._say())
        self.motion.told = answer

    def _say(self) -> list[CommandKind]:
        if self.run.cycle.state is State.READY and self.run.activated_at < 0:
            return [CommandKind.ACTIVATE]
        said, self.says = self.says, []
        return said

    def ticks(self, count: int) -> "TipRun":
        for _ in range(count):
            self.run.tick()
        return self

    def to(self, place: float) -> "TipRun":
        """Until the tip is there."""
        while self.z > place:
            self.run.tick()
            assert self.run.index < 2000
        return self

    def shows(self, axis: int, bit: DriveStatus) -> None:
        """The drive shows a bit of its status, from now on."""
        self.run.stage.drives[axis].extra_status |= int(bit)

    @property
    def motion(self) -> Any:
        """The one that the run was made with."""
        decided = self.run.cycle.supervisor.goals.decided
        assert decided is not None
        return decided.motion

    @property
    def z(self) -> float:
        return float(self.run.true_position[Z])

    @property
    def state(self) -> State:
        return self.run.cycle.state

    @property
    def words(self) -> list[int]:
        return [int(row["motion"]) for row in self.rows]

    def becomes_ready(self) -> None:
        while self.state is not State.READY:
            self.run.tick()
            assert self.run.index < 5000

    def rests(self, *, patience: int = 400) -> int:
        """Ticks until no torque is permitted."""
        begun = self.run.index
        while self.state in (State.ACTIVE, State.STOPPING):
            self.run.tick()
            assert self.run.index - begun < patience
        return self.run.index - begun

    def lines(self, kind: Kind) -> list[str]:
        return [event.line for event in [*self.told, *self._events.close()] if event.kind is kind]

    def is_out(self) -> bool:
        return self.z > SAFE - 8e-5

    def keeps_its_limits(self) -> None:
        li = motion_limits(self.rig)[Z]
        speeds = np.array([row["setpoint_velocity"][Z] for row in self.rows if row["state"] != State.READY])
        assert np.abs(speeds).max() <= li.speed * (1 + 1e-9)
        assert np.abs(np.diff(speeds)).max() <= li.acceleration * PERIOD * 1.01
