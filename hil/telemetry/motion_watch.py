"""What the axes do, from the records of ticks, for programs that move them: 50 times a second, and with each reply."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.cycle.fault_table import Fault
from hil.cycle.goal import RELATIVE, GoalKind, MotionWord
from hil.cycle.state_machine import State
from hil.events.followed import followed
from hil.live.goal_link import TickReader
from hil.rig.schema import RigConfig
from hil.telemetry import telemetry_pb2 as pb

_RESTS: Final = (MotionWord.NONE, MotionWord.HOLD)


class MotionWatch:
    """Follows every tick of a run. rig: the one that runs."""

    def __init__(self, rig: RigConfig) -> None:
        self._n = len(rig.axes)
        self._reader = TickReader(rig)
        self._near = 0  # ticks in a row in which all axes were near
        self._target = [math.nan] * self._n
        self.last: np.void | None = None

    def add(self, records: NDArray[np.void]) -> None:
        """The next ticks, oldest first."""
        if not len(records):
            return
        near = self._reader.near(records)
        far = np.flatnonzero(~near)
        self._near = len(near) - 1 - int(far[-1]) if len(far) else self._near + len(near)
        for place in np.flatnonzero(records["n_goals"]):
            self._follow(records[place - 1] if place else self.last, records[place])
        self.last = records[-1].copy()
        self._hold(self.last)

    def _hold(self, record: np.void | None) -> None:
        if record is not None and record["motion"] == MotionWord.HOLD:
            self._target = record["setpoint_position"][: self._n].tolist()

    def _follow(self, before: np.void | None, record: np.void) -> None:
        """Where the goals of a tick lead, from what was so before."""
        self._hold(before)
        for goal in record["goals"][: record["n_goals"]]:
            if goal["refusal"] == 0 and goal["kind"] not in (GoalKind.RATE, GoalKind.REQUEST):
                self._lead(goal)

    def _lead(self, goal: np.void) -> None:
        places, move = goal["position"].tolist(), goal["kind"] == GoalKind.MOVE
        for axis in range(self._n):
            if not goal["mask"] or int(goal["mask"]) >> axis & 1:
                before = self._target[axis] if goal["flags"] & RELATIVE else 0.0
                self._target[axis] = before + places[axis] if move else math.nan

    def tell(self, now_ns: int, lease: str = "") -> pb.Motion:
        """As of the newest tick. now_ns: monotonic. lease: who moves the rig."""
        last = self.last
        if last is None:
            return pb.Motion(lease=lease)
        n, word = self._n, MotionWord(int(last["motion"]))
        held = bool(followed(np.atleast_1d(last))[0])
        speeds = last["setpoint_velocity"][:n].tolist() if held else [math.nan] * n
        return pb.Motion(
            index=int(last["index"]),
            tick_ns=int(last["now_ns"]),
            state=State(int(last["state"])).name,
            fault=Fault(int(last["fault"])).name,
            motion=word.name,
            goal=int(last["goal_number"]),
            position=last["position"][:n].tolist(),
            velocity=last["velocity_estimate"][:n].tolist(),
            target=self._target if word is not MotionWord.NONE else [math.nan] * n,
            setpoint=last["setpoint_position"][:n].tolist() if held else [math.nan] * n,
            setpoint_velocity=speeds,
            moving=word not in _RESTS and (word is not MotionWord.PAUSED or any(speeds)),
            in_position=self._near >= self._reader.ticks,
            limited=int(last["limited"]),
            lag=(now_ns - int(last["now_ns"])) * 1e-9,
            lease=lease,
        )
