"""Asking a motion: a call in a limited time, whose answer is checked before anything is done with it."""

import math
from collections.abc import Sequence
from typing import Any

from drivers.base import plugins
from drivers.base.guard import Guard
from hil.control.motion.contract import Observation, References, Retreat, Surroundings
from hil.control.plans.axis_plan import MotionLimits
from hil.rig.motion_tables import MOTION_KIND
from hil.rig.schema import RigConfig

_MOST_OUTPUTS = 0xFF
_MOST_PHASE = 0xFFFF
_MOST_CELL = 0xFFFFFFFF


def surroundings(rig: RigConfig, limits: Sequence[MotionLimits]) -> Surroundings:
    """What a motion is told of its rig. limits: what the axes are held to."""
    return Surroundings(
        list(rig.axis_names), rig.period_ns * 1e-9, list(limits), list(rig.sensors),
        [sensor.noise for sensor in rig.sensors.values()],
        {name: output.bit for name, output in rig.outputs.items()},
    )  # fmt: skip


class AskedMotion:
    """The motion that [motion] names. motion: itself. failure: why it no longer counts, with file and line; empty where
    all is well. retreat: the way out that it declares, or None.

    Raises ValueError naming the key.
    """

    def __init__(self, rig: RigConfig, limits: Sequence[MotionLimits]) -> None:
        """limits: what the axes are held to."""
        config = rig.motion
        made = plugins.find(MOTION_KIND, config.name, config.source)
        plugins.check_parameters(MOTION_KIND, config.name, made, config.parameters, given=1)
        guard = Guard(MOTION_KIND, config.name, made)
        self._beginning, self._step = (guard.limited(method, self._fail) for method in ("begin", "step"))
        self._n = len(rig.axes)
        around = surroundings(rig, limits)
        self.motion: Any = guard.call("it cannot be made", made, around, **config.parameters)
        self.retreat: Retreat | None = guard.call("", self._declared, around)
        self.failure = ""

    def _declared(self, around: Surroundings) -> Retreat | None:
        """Raises TypeError or ValueError."""
        declared = getattr(self.motion, "retreat", None)
        if declared is None:
            return None
        if not isinstance(declared, Retreat):
            raise TypeError(f"retreat = {declared!r:.60}, expected hil.Retreat")
        axis, position, direction = declared
        if axis not in around.axes:
            raise ValueError(f"retreat.axis = {axis!r:.40}; the axes are {', '.join(around.axes)}")
        if direction not in (-1, 1):
            raise ValueError(f"retreat.direction = {direction!r:.40}; allowed: -1 or 1")
        li = around.limits[list(around.axes).index(axis)]
        if not li.low <= float(position) <= li.high:
            raise ValueError(f"retreat.position = {position!r:.40}; allowed: from {li.low:g} to {li.high:g}")
        return Retreat(axis, float(position), int(direction))

    def begin(self, position: Sequence[float]) -> None:
        """From rest at `position`, m; what it failed of before is forgotten."""
        self.failure = ""
        with self._beginning:
            self.motion.begin(list(position))

    def step(self, seen: Observation) -> References | None:
        """Its answer; None where there is no usable one, and `failure` says why."""
        if not self.failure:
            with self._step:
                return self._checked(self.motion.step(seen))
        return None

    def _fail(self, why: str) -> None:
        self.failure = why

    def _checked(self, answer: Any) -> References:
        """Raises TypeError or ValueError."""
        if not isinstance(answer, References):
            raise TypeError(f"step returned {answer!r:.60}, expected hil.References")
        a = answer.acceleration
        position, velocity = self._numbers("position", answer.position), self._numbers("velocity", answer.velocity)
        acceleration = None if a is None else self._numbers("acceleration", a)
        for name, value, most in (
            ("outputs", answer.outputs, _MOST_OUTPUTS), ("phase", answer.phase, _MOST_PHASE),
            ("cell", answer.cell, _MOST_CELL),
        ):  # fmt: skip
            if type(value) is not int or not 0 <= value <= most:
                raise ValueError(f"step returned {name} = {value!r:.40}; allowed: a whole number from 0 to {most}")
        return answer._replace(position=position, velocity=velocity, acceleration=acceleration, done=bool(answer.done))

    def _numbers(self, name: str, values: Any) -> list[float]:
        found = [float(value) for value in values]
        if len(found) != self._n:
            raise ValueError(f"step returned {len(found)} values of {name} for {self._n} axes")
        if not all(math.isfinite(value) for value in found):
            raise ValueError(f"step returned {name} = {found}")
        return found
