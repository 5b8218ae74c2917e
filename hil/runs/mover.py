"""Move a rig from Python: goals with their units and limits checked before they are sent, refusals in words.

    with hil.motion("microscope") as m:              # a running rig; hil.motion(hil.load_rig(...)): in virtual time
        m.move_to(x=1e-3, z=-2e-3, speed=0.5).wait()
        m.jog(x=2e-3)

Every plan ends at rest inside the travel, whatever becomes of this program.
"""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from typing import Final, Self

from hil.control.motion.contract import Request
from hil.control.plans.pace import MOST_RATE
from hil.cycle.goal import (
    LINE,
    MOST_JOG_S,
    RELATIVE,
    Goal,
    GoalKind,
    GoalRefusedError,
    MotionError,
    MotionWord,
    Refusal,
    Values,
)
from hil.cycle.limits import motion_limits, motion_windows
from hil.cycle.state_machine import State
from hil.live.goal_link import GoalLink, Look
from hil.live.task_loading import rig_with_task
from hil.rig.schema import MAX_AXES
from hil.runs.streaming import LEAD_S, Row, Streamed, stream

LOOK_S: Final = 5e-3
SETTLE_S: Final = 5.0  # in which axes whose set-points rest must be in position
MOST_DUE_S: Final = 10.0


class Move:
    """A goal that was taken. number: of the goal."""

    def __init__(self, mover: "Mover", number: int, targets: Mapping[int, float]) -> None:
        self.number = number
        self._mover, self._targets = mover, targets

    @property
    def done(self) -> bool:
        """The axes are in position. Raises MotionError where the rig no longer holds, or they rest elsewhere."""
        return self._over(self._mover.status())

    def _over(self, look: Look) -> bool:
        if look.state is not State.ACTIVE:
            raise MotionError(f"the rig left ACTIVE on the way: it is {look.state.name}, fault {look.fault.name}")
        if look.number < self.number or look.motion is not MotionWord.HOLD:
            return False
        for axis, target in self._targets.items():
            if look.setpoint[axis] != target:
                name = self._mover.axes[axis]
                raise MotionError(f"{name} rests at {look.setpoint[axis]:.9g}, not at {target:.9g}: cut short")
        return look.in_position

    def wait(self, timeout_s: float | None = None) -> Look:
        """Until the axes are in position; the tick in which they are. Raises MotionError as `done`, and where they are
        not SETTLE_S after the set-points came to rest; TimeoutError.
        """
        return self._mover.await_rest(self._over, timeout_s)

    def cancel(self) -> None:
        """Stop here, and hold."""
        self._mover.halt()


class Mover:
    """Moves one rig, alone: it holds the lease. Positions in m, velocities in m/s (rad), by axis name.

    Use it in a `with` block: what it has begun is brought to rest at the end, also after an exception, and the rig goes
    on holding. All methods raise MotionError where the rig or the lease is gone, GoalRefusedError where a goal has no
    effect, ValueError for numbers and axes that no goal can have.
    """

    def __init__(self, link: GoalLink, *, take: bool = False) -> None:
        """take: also where somebody else moves the rig."""
        self._link = link
        self.axes = link.rig.axis_names
        self.kinds = {name: axis.kind for name, axis in link.rig.axes.items()}  # linear or rotary
        self._limits = motion_limits(link.rig)
        self._moves = False
        link.take(by_force=take)

    # goals ------------------------------------------------------------------------------------------------------------

    def move_to(self, *, speed: float = 1.0, line: bool = False, **targets: float) -> Move:
        """Move axes to positions, begun and ended together. speed: of the axes' motion limits, above 0 to 1.
        line: along the straight line.
        """
        return self._to(self._by_axis(targets), speed, LINE if line else 0)

    def _to(self, places: dict[int, float], speed: float = 1.0, flags: int = 0) -> Move:
        for axis, target in places.items():
            li = self._limits[axis]
            if not li.low <= target <= li.high:
                name = self.axes[axis]
                raise GoalRefusedError(
                    Refusal.FENCE,
                    f"{name} = {target:g}: from {li.low:.6g} to {li.high:.6g} (axes.{name}.limits.position less the "
                    "margin for a stop)",
                )
        return self._move(places, speed, flags, places)

    def move_by(self, *, speed: float = 1.0, line: bool = False, **steps: float) -> Move:
        """The same, counted from the target in force, not from the encoder."""
        return self._move(self._by_axis(steps), speed, RELATIVE | (LINE if line else 0), {})

    def jog(self, *, seconds: float = 0.1, **velocities: float) -> Move:
        """Move axes at velocities for at most 0.5 s, then to rest. Call it again to go on."""
        found = self._by_axis(velocities)
        for axis, velocity in found.items():
            most, name = self._limits[axis].speed, self.axes[axis]
            if abs(velocity) > most:
                raise GoalRefusedError(
                    Refusal.LIMITS, f"{name} = {velocity:g}: at most {most:g} (axes.{name}.motion.speed)"
                )
        _within("seconds", seconds, 1e-3, MOST_JOG_S)
        goal = Goal(0, GoalKind.JOG, _mask(found), valid_ns=round(seconds * 1e9), velocity=_values(found))
        return self._taken(goal)

    def range_of(self, axis: str) -> tuple[float, float]:
        """From where to where goals may send the axis, m (rad): its travel less the margin for a stop."""
        limits = self._limits[self.axes.index(axis)]
        return limits.low, limits.high

    def window_of(self, axis: str) -> float:
        """How far from its set-point the axis is still in position, m (rad)."""
        return motion_windows(self._link.rig)[self.axes.index(axis)]

    def most_speed(self, axis: str) -> float:
        """Of goals for the axis, m/s (rad/s)."""
        return self._limits[self.axes.index(axis)].speed

    def send(self, position: Mapping[str, float], velocity: Mapping[str, float] | None = None, *, due: float) -> None:
        """A stream's next point: be there, with that velocity (0), in `due` s, 0 to 10. Without another one the axes
        come to rest behind it. What is beyond the limits is limited.
        """
        places = self._by_axis(position)
        speeds = self._by_axis(velocity or dict.fromkeys(position, 0.0))
        if places.keys() != speeds.keys():
            raise ValueError(f"velocity: of the axes {', '.join(position)}, got {', '.join(velocity or ())}")
        _within("due", due, 0.0, MOST_DUE_S)
        self._taken(
            Goal(
                0, GoalKind.KNOT, _mask(places), due_ns=round(due * 1e9), position=_values(places),
                velocity=_values(speeds),
            )
        )  # fmt: skip

    def path(
        self, points: Mapping[str, Sequence[float]], *, speed: float | None = None, acceleration: float | None = None,
        jerk: float | None = None, blend: float = 0.0, dwell_s: float = 0.0, repeat: bool = False,
    ) -> Move:  # fmt: skip
        """Go to the first of the points, then along straight lines through all of them. points: by axis, all of one
        length. speed, acceleration, jerk: of an axis, at most and by default the least of the axes' motion limits.
        blend: points are passed at no more than this, m (rad), without stopping; 0: a rest of dwell_s at each.
        repeat: until `halt`.

        Returns once the path has begun, and is done where it ends. Raises as all, and RigError for what is no path.
        """
        lengths = {name: len(values) for name, values in points.items()}
        if len(set(lengths.values())) != 1 or 0 in lengths.values():
            raise ValueError(f"points: as many for each axis, at least two; got {lengths}")
        first = self._by_axis({name: values[0] for name, values in points.items()})
        rows = [list(map(float, row)) for row in zip(*points.values(), strict=True)]
        motion = {
            "speed": self._least("speed", speed, first),
            "acceleration": self._least("acceleration", acceleration, first),
            "jerk": self._least("jerk", jerk, first),
        }
        task = {
            "kind": "waypoints", "axes": list(points), "waypoints": rows, **motion, "blend": blend, "dwell_s": dwell_s,
            "repeat": repeat, "approach_s": self._link.rig.period_ns * 1e-9, "settle_s": 0.0,
        }  # fmt: skip
        checked = rig_with_task(self._link.rig, json.dumps(task)).task
        self._to(first).wait()
        self._link.load_task(checked)
        ends = {} if repeat else dict(zip(first, rows[-1], strict=True))
        return self._taken(Goal(0, GoalKind.PATH), ends)

    def _least(self, name: str, asked: float | None, axes: Iterable[int]) -> float:
        """What a path may take, of what its axes have. Raises GoalRefusedError."""
        most, axis = min((getattr(self._limits[axis], name), self.axes[axis]) for axis in axes)
        if asked is not None and not 0.0 < asked <= most:
            raise GoalRefusedError(
                Refusal.LIMITS, f"{name} = {asked:g}: above 0, at most {most:g} (axes.{axis}.motion.{name})"
            )
        return float(most if asked is None else asked)

    def stream(self, rows: Iterable[Row], *, lead: float = LEAD_S) -> Streamed:
        """Go to the first of timed rows, then through them as they come. rows: of time, s, and m (rad) by axis. lead:
        s after its time that a row is reached, up to 10. Returns when the last one is due, where the axes come to rest;
        `wait` awaits that. A row that comes too late is left out and counted.
        """
        _within("lead", lead, 1e-3, MOST_DUE_S)
        remaining = iter(rows)
        first = next(remaining, None)
        if first is None:
            return Streamed(0, 0, {})
        self._to(self._by_axis(first[1])).wait()
        done = stream(self, chain([first], remaining), lead)
        self.sleep(lead)
        self._to(self._by_axis(done.last))  # exactly there: behind a knot alone its acceleration fades away
        return done

    def play(self) -> Move:
        """Begin the rig's task, or the one loaded last, where the stage rests."""
        return self._taken(Goal(0, GoalKind.PATH))

    def rate(self, rate: float) -> None:
        """Let the task's time pass that fast: 0 pauses it, 1 is as planned, at most 1.2."""
        _within("rate", rate, 0.0, MOST_RATE)
        self._taken(Goal(0, GoalKind.RATE, speed=rate))

    def pause(self) -> None:
        """Bring the task to rest on its path."""
        self.rate(0.0)

    def resume(self) -> None:
        """Go on with it."""
        self.rate(1.0)

    def halt(self) -> Move:
        """Stop here, by a plan, and keep holding. To let go of the stage is `command("stop")`."""
        return self._taken(Goal(0, GoalKind.HALT))

    def ask(self, request: Request) -> None:
        """Ask something of the motion that runs ([motion] name); the rig goes on by it."""
        _, refusal = self._link.send(Goal(0, GoalKind.REQUEST, flags=int(request)))
        if refusal is not Refusal.NONE:
            raise GoalRefusedError(refusal, f"{request.name.lower()}: {refusal.text}")

    # what becomes of them ---------------------------------------------------------------------------------------------

    def status(self) -> Look:
        """The newest tick: state, fault, motion, set-points, positions."""
        return self._link.look()

    def now_ns(self) -> int:
        """The rig's time: this machine's monotonic clock, or virtual time."""
        return self._link.now_ns()

    def sleep(self, seconds: float) -> None:
        """Let time pass: the rig's, which in virtual time is exact."""
        self._link.wait(seconds)

    def wait(self, timeout_s: float | None = None) -> Look:
        """Until all axes are in position. Raises MotionError where they are not SETTLE_S after the set-points came to
        rest; TimeoutError.
        """
        return self.await_rest(lambda look: look.in_position, timeout_s)

    def await_rest(self, over: Callable[[Look], bool], timeout_s: float | None = None) -> Look:
        """The same until a tick is over(); that tick. Times count in the rig's time."""
        began = rests_since = self.now_ns()
        while not over(look := self.status()):
            now = self.now_ns()
            if timeout_s is not None and now - began > timeout_s * 1e9:
                raise TimeoutError(f"{self._link.rig.name} has not come to rest within {timeout_s:g} s")
            if look.motion is not MotionWord.HOLD:
                rests_since = now
            elif now - rests_since > SETTLE_S * 1e9:
                raise MotionError(self._far(look))
            self._link.wait(LOOK_S)
        return look

    def _far(self, look: Look) -> str:
        """The axes that are not in position, in words."""
        axes = zip(self.axes, look.position, look.setpoint, motion_windows(self._link.rig), strict=True)
        far = [
            f"{name} is {at - wanted:.3g} from its set-point, beyond axes.{name}.motion.window = {window:g}"
            for name, at, wanted, window in axes
            if abs(at - wanted) > window
        ]
        return f"not in position {SETTLE_S:g} s after the set-points came to rest: {'; '.join(far) or 'it swings'}"

    def close(self) -> None:
        """Bring to rest what was begun, and give the lease back; the rig goes on holding."""
        try:
            if self._moves and self.status().motion not in (MotionWord.HOLD, MotionWord.NONE):
                self.halt()
        except MotionError:
            pass  # it is no longer ours, and every plan ends at rest
        finally:
            self._link.leave()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # ------------------------------------------------------------------------------------------------------------------

    def _by_axis(self, values: Mapping[str, float]) -> dict[int, float]:
        if not values:
            raise ValueError(f"no axis: name at least one of {', '.join(self.axes)}")
        for name, value in values.items():
            if name not in self.axes:
                raise ValueError(f"no axis {name!r}: the rig has {', '.join(self.axes)}")
            if not math.isfinite(value):
                raise ValueError(f"{name} = {value}: not a finite number")
        return {self.axes.index(name): float(value) for name, value in values.items()}

    def _move(self, places: dict[int, float], speed: float, flags: int, targets: Mapping[int, float]) -> Move:
        _within("speed", speed, 1e-3, 1.0)
        goal = Goal(0, GoalKind.MOVE, _mask(places), flags, position=_values(places), speed=speed)
        return self._taken(goal, targets)

    def _taken(self, goal: Goal, targets: Mapping[int, float] | None = None) -> Move:
        number, refusal = self._link.send(goal)
        if refusal is not Refusal.NONE:
            raise GoalRefusedError(refusal, self._reason(goal, refusal))
        self._moves = True
        return Move(self, number, targets or {})

    def _reason(self, goal: Goal, refusal: Refusal) -> str:
        name = GoalKind(goal.kind).name.lower()
        if refusal is Refusal.NOT_ACTIVE:
            return f"{name}: the rig is {self.status().state.name}; goals are taken in ACTIVE, once it holds"
        if refusal is Refusal.FENCE:
            axes = [axis for axis in range(len(self.axes)) if goal.mask >> axis & 1]
            ranges = (f"{self.axes[a]} {self._limits[a].low:.6g} to {self._limits[a].high:.6g}" for a in axes)
            return f"{name}: {refusal.text}: {', '.join(ranges)}"
        return f"{name}: {refusal.text}"


def _mask(values: Mapping[int, float]) -> int:
    return sum(1 << axis for axis in values)


def _values(values: Mapping[int, float]) -> Values:
    p0, p1, p2, p3 = (values.get(axis, 0.0) for axis in range(MAX_AXES))
    return p0, p1, p2, p3


def _within(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise ValueError(f"{name} = {value:g}: from {low:g} to {high:g}")
