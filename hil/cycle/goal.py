"""Goals: what a running rig may be asked to do next, as it comes in with a tick and stands in its record."""

from enum import IntEnum
from typing import Final, NamedTuple

MOST_GOALS: Final = 2  # that a tick takes; of more the newest of each kind count
MOST_JOG_S: Final = 0.5  # that a jog may be valid for
RELATIVE: Final = 1  # flags: positions count from the target in force
LINE: Final = 2  # along the straight line
LEAD_OUT: Final = "; lead it out: "  # in the words on a tip that was left inside: between what is so and the commands


class GoalKind(IntEnum):
    """What is asked for."""

    MOVE = 1  # to `position`, all axes begun and ended together
    JOG = 2  # at `velocity` for `valid_ns`, then to rest
    KNOT = 3  # of a stream: at `position` with `velocity` after `due_ns`, then to rest
    PATH = 4  # the rig's task, or the one loaded last, from where the stage rests
    RATE = 5  # of the path's time: `speed`; 0 is a pause
    HALT = 6  # stop here, and hold
    REQUEST = 7  # of the motion that runs: `flags` is a hil.control.motion.contract.Request


class MotionWord(IntEnum):
    """What the axes do under torque."""

    NONE = 0  # not ACTIVE, or not yet
    TASK = 1
    HOLD = 2
    MOVE = 3
    JOG = 4
    STREAM = 5
    PATH = 6
    MOTION = 7
    PAUSED = 8
    WITHDRAW = 9  # in STOPPING: the tip goes to its safe height first


class Refusal(IntEnum):
    """Why a goal has no effect."""

    NONE = 0
    NOT_ACTIVE = 1  # the state takes none, or the drives are not enabled yet
    UNKNOWN = 2  # no such kind, axis or flag
    NOT_FINITE = 3  # a number that is none, or out of its range
    FENCE = 4  # beyond the travel less its margin
    LIMITS = 5  # no plan keeps the limits from the motion in force
    TASK = 6  # motion.interrupt = false, or a law that learns from the task
    NO_PATH = 7  # there is none to pause or to begin, or the stage is not at rest where it may begin
    SUPERSEDED = 8  # by a newer one of its kind in the same tick
    STALE = 9  # it waited too long; never reaches the cycle
    FOREIGN = 10  # of a lease that has ended; never reaches the cycle
    NO_MOTION = 11  # none that decides runs, so nothing can be asked of it

    @property
    def text(self) -> str:
        """For people."""
        return _TEXTS[self]


_TEXTS: dict[int, str] = {
    Refusal.NONE: "",
    Refusal.NOT_ACTIVE: "no goal is taken in this state",
    Refusal.UNKNOWN: "no such goal, axis or flag",
    Refusal.NOT_FINITE: "a number is not finite or out of its range",
    Refusal.FENCE: "the target is beyond the travel less its margin",
    Refusal.LIMITS: "no plan keeps the limits from the motion in force",
    Refusal.TASK: "the task may not be interrupted",
    Refusal.NO_PATH: "no path to begin or to pause here",
    Refusal.SUPERSEDED: "a newer goal of its kind came in the same tick",
    Refusal.STALE: "it waited too long for the control process",
    Refusal.FOREIGN: "the lease that it was sent under has ended",
    Refusal.NO_MOTION: "no motion runs that could be asked",
}


class MotionError(Exception):
    """A rig cannot be moved, or a goal was not carried out; the text says why."""


class GoalRefusedError(MotionError):
    """A goal had no effect. refusal: why."""

    def __init__(self, refusal: Refusal, text: str) -> None:
        super().__init__(text)
        self.refusal = refusal


Values = tuple[float, float, float, float]


class Goal(NamedTuple):
    """number: of its sender, rising. mask: bit i for axis i; 0: all. due_ns, valid_ns: from the tick that takes it.
    position, velocity: m and m/s (rad), by axis. speed: of the limit, above 0 to 1; of RATE: the rate, 0 to 1.2.
    """

    number: int
    kind: int
    mask: int = 0
    flags: int = 0
    due_ns: int = 0
    valid_ns: int = 0
    position: Values = (0.0, 0.0, 0.0, 0.0)
    velocity: Values = (0.0, 0.0, 0.0, 0.0)
    speed: float = 1.0
    lease: int = 0
