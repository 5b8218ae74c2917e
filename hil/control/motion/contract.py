"""What a motion is: it says, tick by tick, where the axes should be at the end of the coming interval."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

from hil.control.plans.axis_plan import MotionLimits
from hil.control.reading import Reading


class Request(IntEnum):
    """What an operator asks of a motion while it runs. What it means is the motion's own to say; one that looks at none
    of them goes on.
    """

    NONE = 0
    PAUSE = 1
    RESUME = 2
    SKIP = 3  # what it is at now
    ABORT = 4  # end in good order


class Surroundings(NamedTuple):
    """What a motion is told of its rig when it is made.

    axes: their names. period: s. limits: what each axis is held to, m/s, m/s^2, m/s^3 and the fence, m (rad). sensors:
    names, in the order of the readings. noise: RMS of each, in its unit. outputs: bit by name.
    """

    axes: Sequence[str]
    period: float
    limits: Sequence[MotionLimits]
    sensors: Sequence[str]
    noise: Sequence[float]
    outputs: Mapping[str, int]


class Observation(NamedTuple):
    """What a motion may look at in one tick. Lists are by axis, in the order of the rig file; SI (rad for rotary axes).

    tick: of the motion, 0 in its first. ends_ns: the instants that references are asked for, since the motion began;
    each axis counts by the stamps of its own drive. position, velocity: where the axis is and how fast it moves, by
    the rig's own filter, when the coming force begins to act. reference: position, velocity and acceleration in force
    at that instant, m, m/s, m/s^2: what was asked for a tick ago, where it was within the limits. readings: the newest
    of every sensor. ages: ticks since each was sampled. request: what the operator asks for in this tick alone.
    outputs: bit i where output i was set a tick ago. A tick with a fault clears it, and it stays so until it is asked
    for anew.
    """

    tick: int
    ends_ns: Sequence[int]
    position: Sequence[float]
    velocity: Sequence[float]
    reference: Sequence[tuple[float, float, float]]
    readings: Sequence[Reading]
    ages: Sequence[int]
    request: Request = Request.NONE
    outputs: int = 0


class References(NamedTuple):
    """What a motion answers: the references at the end of the coming interval, by axis.

    position: m. velocity: m/s. acceleration: m/s^2; None: what the change of velocity means. outputs: bit i sets
    output i of the rig in this tick. phase, cell: numbers of the motion's own for the record. done: the motion is over;
    the axes come to rest and are held.
    """

    position: Sequence[float]
    velocity: Sequence[float]
    acceleration: Sequence[float] | None = None
    outputs: int = 0
    phase: int = 0
    cell: int = 0
    done: bool = False


class Retreat(NamedTuple):
    """The way out of a cell, along one axis of the rig. Before the rig stops, it carries the axis there by itself.

    axis: its name. position: the safe height, m, inside the fence. direction: 1 or -1, the sign of the way in.
    """

    axis: str
    position: float
    direction: int


class Motion(ABC):
    """A motion of your own: it decides each tick where to go, by what it sees.

        class UntilForce(hil.Motion):
            def __init__(self, rig, speed=1e-3, force=5e-4):
                self.z, self.speed, self.most = rig.axes.index("z"), speed, force
                self.way = speed * rig.period

            def begin(self, position):
                self.place = list(position)

            def step(self, seen):
                velocity = [0.0] * len(self.place)
                touched = seen.readings[0].value > self.most
                if not touched:
                    self.place[self.z] -= self.way
                    velocity[self.z] = -self.speed
                return hil.References(self.place, velocity, done=touched)

    rig: what is there. Parameters are those of [motion.parameters].

    What it asks for is held to travel, speed, acceleration and jerk of [axes.NAME.motion]: an axis that is asked for
    more goes there as fast as these allow, and the tick is counted in `limited`. One that raises, answers what is no
    number, or does not answer, ends: the axes come to rest and are held.

    retreat: set it in __init__ where the tip goes into something. The rig then leads the tip out before it stops: after
    a fault, a stop, or a failure of the motion. It is read once.
    """

    retreat: Retreat | None = None

    def __init__(self, rig: Surroundings, **parameters: Any) -> None:  # noqa: B027
        """Every motion is made like this, once for each control cycle."""

    @abstractmethod
    def begin(self, position: Sequence[float]) -> None:
        """The axes are held at `position`, (n_axes,) m, and the first `step` follows in the same tick."""

    @abstractmethod
    def step(self, seen: Observation) -> References:
        """The references at seen.ends_ns. Called once a tick; it must return well within the period."""
