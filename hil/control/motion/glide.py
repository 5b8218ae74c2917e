"""One axis of a motion, on plans of its own: to a place at a speed, or to rest, from whatever is in force."""

from hil.control.plans.axis_plan import AxisPlan, MotionLimits
from hil.control.plans.moves import halt, jog, move

_JERK = 1.0 / 1.8  # of the axis' own: a quintic across a change of jerk takes up to 1.75 times as much
_APART = 1e-10  # m (rad): what is in force is not what was asked for


class Glide:
    """limits: what the axis is held to. period_ns: of a tick.

    A plan begins where the coming interval does, in the motion in force there; `at` gives what to ask for at its end.
    """

    def __init__(self, limits: MotionLimits, period_ns: int) -> None:
        self._own = MotionLimits(limits.speed, limits.acceleration, limits.jerk * _JERK, limits.low, limits.high)
        self._period_ns = period_ns
        self._plan = AxisPlan(0.0, 0.0, 0.0)
        self._begins_ns = 0
        self._asked = self._speed = self.target = 0.0

    def hold(self, position: float) -> None:
        """At rest there."""
        self._plan, self._begins_ns = AxisPlan(position, 0.0, 0.0), 0
        self._asked = self.target = position

    def to(self, ends_ns: int, state: tuple[float, float, float], target: float, speed: float) -> None:
        """From `state` (m, m/s, m/s^2) on to `target`, m, inside the fence, at no more than `speed`, m/s. ends_ns: of
        the coming interval.
        """
        own = self._own
        self._speed = speed
        self.target = max(own.low, min(own.high, target))
        share = min(max(speed, abs(state[1])) / own.speed, 1.0)
        self._plan, self._begins_ns = move(*state, self.target, own.slowed(share)), ends_ns - self._period_ns

    def jog(self, ends_ns: int, state: tuple[float, float, float], speed: float, seconds: float) -> None:
        """On at `speed`, m/s, either way, for so long; then to rest."""
        own = self._own
        wanted = max(-own.speed, min(own.speed, speed))
        self._plan, self._begins_ns = jog(*state, wanted, seconds, own), ends_ns - self._period_ns
        self.target = self._plan.target

    def stop(self, ends_ns: int, state: tuple[float, float, float]) -> None:
        """To rest as quickly as the limits allow."""
        self._plan, self._begins_ns = halt(*state, self._own), ends_ns - self._period_ns
        self.target = self._plan.target

    def follow(self, ends_ns: int, state: tuple[float, float, float]) -> None:
        """Plan anew where the axis could not be brought to what was asked for last. state: in force."""
        if abs(state[0] - self._asked) > _APART:
            self.to(ends_ns, state, self.target, self._speed or self._own.speed)

    def at(self, ends_ns: int) -> tuple[float, float, float]:
        """Position, velocity and acceleration at the end of the coming interval."""
        found = self._plan.at((ends_ns - self._begins_ns) * 1e-9)
        self._asked = found[0]
        return found

    def rests(self, ends_ns: int) -> bool:
        """Whether the plan has come to its end by then."""
        return (ends_ns - self._begins_ns) * 1e-9 >= self._plan.ends
