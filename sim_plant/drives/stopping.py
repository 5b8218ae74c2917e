"""How a CiA 402 drive comes to rest: option codes 605Ah to 605Eh (CiA 402-2), and the slope of a torque (6087h).

Rules. What these options do to a motor under a loop of the drive's own is a deceleration; under torque it is the slope
6087h, for there is no speed to govern. "On the current limit" and "on the voltage limit" are at once here: the emulated
loops have neither. Without the object itself, or with a maker's value in the file, a drive does what it says here too
(`ABSENT`); a value that is not supported cannot be written.
"""

from collections.abc import Mapping
from enum import Enum, auto
from math import copysign, inf
from typing import NamedTuple

from drivers.families.cia402.cia301 import DriveState
from sim_plant.drives.object_dictionary import ObjectDictionary, key_of


class Ramp(Enum):
    """What ends a motion."""

    LET_GO = auto()  # the power stage goes off: it runs out
    SLOW_DOWN = auto()  # 6084h
    QUICK_STOP = auto()  # 6085h
    AT_ONCE = auto()


class Option(NamedTuple):
    """What an option code's value means. stays: in QUICK STOP ACTIVE (605Ah), where others go on to the next state."""

    ramp: Ramp
    stays: bool = False


class Stop(NamedTuple):
    """A drive that is coming to rest. following: its state once it stands."""

    ramp: Ramp
    following: DriveState


QUICK_STOP, SHUTDOWN, DISABLE, HALT, FAULT_REACTION = (key_of(0x605A + place) for place in range(5))

_LIMITS = {3: Option(Ramp.AT_ONCE), 4: Option(Ramp.AT_ONCE)}
_LET_GO, _SLOW_DOWN, _QUICK_STOP = Option(Ramp.LET_GO), Option(Ramp.SLOW_DOWN), Option(Ramp.QUICK_STOP)
_LEAVES = {0: _LET_GO, 1: _SLOW_DOWN, 2: _QUICK_STOP} | _LIMITS
OPTIONS: Mapping[int, Mapping[int, Option]] = {
    QUICK_STOP: _LEAVES | {value + 4: Option(_LEAVES[value].ramp, stays=True) for value in (1, 2, 3, 4)},
    SHUTDOWN: {0: _LET_GO, 1: _SLOW_DOWN},
    DISABLE: {0: _LET_GO, 1: _SLOW_DOWN},
    HALT: {1: _SLOW_DOWN, 2: _QUICK_STOP} | _LIMITS,
    FAULT_REACTION: {0: _LET_GO, 1: _SLOW_DOWN, 2: _QUICK_STOP} | _LIMITS,
}
ABSENT: Mapping[int, Option] = {
    QUICK_STOP: Option(Ramp.AT_ONCE, stays=True),
    SHUTDOWN: _LET_GO,
    DISABLE: _LET_GO,
    HALT: Option(Ramp.AT_ONCE),
    FAULT_REACTION: _LET_GO,
}

_PROFILE_ACCELERATION, _PROFILE_DECELERATION = key_of(0x6083), key_of(0x6084)
_QUICK_DECELERATION = key_of(0x6085)
_TORQUE_SLOPE = key_of(0x6087)


def option(dictionary: ObjectDictionary, key: int) -> Option:
    """What an option code asks for at present."""
    value = dictionary.values.get(key)
    return OPTIONS[key].get(value, ABSENT[key]) if isinstance(value, int) else ABSENT[key]


def deceleration(dictionary: ObjectDictionary, ramp: Ramp) -> float:
    """Of a motor under a loop, counts/s^2; inf at once. 6084h, for a quick stop 6085h; 6083h stands in for both."""
    if ramp is Ramp.AT_ONCE:
        return inf
    slow = dictionary.number(_PROFILE_DECELERATION) or dictionary.number(_PROFILE_ACCELERATION)
    quick = dictionary.number(_QUICK_DECELERATION) if ramp is Ramp.QUICK_STOP else 0
    return quick or slow or inf


def torque_slope(dictionary: ObjectDictionary, rated: float) -> float:
    """6087h in N m/s (N/s), from thousandths of the rated torque per second; inf without it. rated: N m (N)."""
    return dictionary.number(_TORQUE_SLOPE) * rated * 1e-3 or inf


class TorqueRamp:
    """A torque (N m, or N) on its way to a goal. value: as it is now."""

    def __init__(self) -> None:
        self.value = 0.0
        self._start = self._goal = 0.0
        self._slope = inf
        self._since_ns = 0

    @property
    def arrived(self) -> bool:
        """It is at its goal."""
        return self.value == self._goal

    def jump(self, value: float) -> None:
        """Be there at once, and stay."""
        self.value = self._goal = value

    def head_for(self, goal: float, slope: float, now_ns: int) -> None:
        """Begin towards a goal. slope: per second."""
        self._start, self._goal, self._slope, self._since_ns = self.value, goal, slope, now_ns

    def follow(self, now_ns: int) -> float:
        """The value at an instant."""
        way = self._goal - self._start
        passed = self._slope * ((now_ns - self._since_ns) * 1e-9) if self._slope < inf else inf
        if not self.arrived:
            self.value = self._goal if passed >= abs(way) else self._start + copysign(passed, way)
        return self.value
