"""Goals of one axis as plans, from any motion in force: stop, move to a place, jog, meet a knot of a stream.

A move is a ramp to a cruising velocity, cruising, and a ramp to rest. The velocity is looked for on the short side, and
cruising makes up for the rest of the way: a move so ends on its target exactly.

Rules: each function returns a plan that ends at rest; whether it keeps the limits is for `AxisPlan.keeps` to say, and
for the caller to ask. Where a stop or a move would leave the fence, which only the motion of a stream can bring about,
one that turns back sooner is looked for.
"""

from typing import Final

from hil.control.plans.axis_plan import AxisPlan, MotionLimits
from hil.control.plans.ramps import Ramp, add_ramp, stop_time, stop_way

STEPS: Final = 24  # of a search
NEAR: Final = 1e-13  # of the travel: no way at all
CLOSE_S: Final = 1e-5  # of cruising left to do: near enough to the quickest
SHORTEST: Final = 1e-6  # of the time to a knot: under way for less, no axis keeps its jerk
TURNS: Final = 8  # ways to turn back that are tried


def halt(position: float, velocity: float, acceleration: float, limits: MotionLimits) -> AxisPlan:
    """A stop, as quick as can be, without leaving the fence."""
    plan = AxisPlan(position, velocity, acceleration)
    add_ramp(plan, 0.0, limits)
    plan.settle(plan.position)
    if plan.keeps(limits):
        return plan
    back = -1.0 if plan.high > limits.high else 1.0
    for turn in range(TURNS):
        there = AxisPlan(position, velocity, acceleration)
        add_ramp(there, back * limits.speed / (1 << (TURNS - 1 - turn)), limits)
        add_ramp(there, 0.0, limits)
        there.settle(there.position)
        if there.keeps(limits):
            return there
    return plan


def move(
    position: float, velocity: float, acceleration: float, target: float, limits: MotionLimits, seconds: float = 0.0
) -> AxisPlan:
    """To `target`, m. seconds: where it would be there sooner, slowed so that it takes about as long."""
    plan = _move(position, velocity, acceleration, target, limits, seconds)
    if plan.keeps(limits) or (velocity == 0.0 and acceleration == 0.0):
        return plan
    stopped = halt(position, velocity, acceleration, limits)
    return add_move(stopped, target, limits) if stopped.keeps(limits) else plan


def add_move(plan: AxisPlan, target: float, limits: MotionLimits) -> AxisPlan:
    """The plan, which ends at rest, followed by a move from there."""
    _append(plan, _Search(0.0, 0.0, target - plan.position, limits).cruise(), target, limits)
    return plan


def _move(p: float, v: float, a: float, target: float, limits: MotionLimits, seconds: float) -> AxisPlan:
    plan = AxisPlan(p, v, a)
    search = _Search(v, a, target - p, limits)
    eased = search.eased()
    if eased > 0.0:
        plan.push(limits.jerk if a < 0.0 else -limits.jerk, eased)
        search = _Search(plan.velocity, plan.last_acceleration, target - plan.position, limits)
    cruise = search.cruise()
    if seconds > 0.0:
        cruise = search.slower(cruise, seconds)
    _append(plan, cruise, target, limits)
    return plan


def _append(plan: AxisPlan, cruise: float, target: float, limits: MotionLimits) -> None:
    way = target - plan.position
    if cruise != 0.0:
        first = Ramp(plan.velocity, plan.last_acceleration, cruise, limits)
        stop = stop_way(abs(cruise), limits)
        left = way - first.way - (stop if cruise > 0.0 else -stop)
        first.append(plan, cruise)
        plan.push(0.0, left / cruise)
    add_ramp(plan, 0.0, limits)
    plan.settle(target)


class _Search:
    """Which cruising velocity brings an axis furthest of what does not bring it too far. way: m, to the target."""

    __slots__ = ("_a", "_limits", "_sign", "_v", "_way")

    def __init__(self, velocity: float, acceleration: float, way: float, limits: MotionLimits) -> None:
        self._limits = limits
        left = way - Ramp(velocity, acceleration, 0.0, limits).way
        near = NEAR * (limits.high - limits.low)
        self._sign = 0.0 if abs(left) <= near else 1.0 if left > 0.0 else -1.0
        self._v, self._a, self._way = self._sign * velocity, self._sign * acceleration, self._sign * way

    def _beyond(self, cruise: float) -> float:
        """By how much ramps to `cruise` and to rest go too far, m; seen from the side of the target."""
        return Ramp(self._v, self._a, cruise, self._limits).way + stop_way(cruise, self._limits) - self._way

    def eased(self) -> float:
        """How long to brake less before the stop, s: where a stop at once ends short of the target, and one that begins
        when the acceleration is gone too far.
        """
        jerk = self._limits.jerk
        kept = self._v - 0.5 * self._a * self._a / jerk
        if self._sign == 0.0 or self._a >= 0.0 or kept <= 0.0 or self._beyond(kept) <= 0.0:
            return 0.0
        low, high = 0.0, -self._a / jerk
        for _ in range(STEPS):
            t = 0.5 * (low + high)
            v = self._v + t * (self._a + 0.5 * t * jerk)
            way = t * (self._v + t * (0.5 * self._a + t * jerk / 6.0))
            if way + Ramp(v, self._a + t * jerk, 0.0, self._limits).way <= self._way:
                low = t
            else:
                high = t
        return low

    def cruise(self) -> float:
        """The velocity, m/s; 0: a stop is all that it takes."""
        if self._sign == 0.0:
            return 0.0
        high = self._limits.speed
        beyond_high = self._beyond(high)
        if beyond_high <= 0.0:
            return self._sign * high
        # Once the acceleration is gone the axis has this velocity, and cruising on with it is the quickest there is.
        low, beyond_low = 0.0, -self._way
        kept = self._v + self._a * abs(self._a) / (2.0 * self._limits.jerk)
        if 0.0 < kept < high:
            beyond = self._beyond(kept)
            if beyond <= 0.0:
                low, beyond_low = kept, beyond
            else:
                high, beyond_high = kept, beyond
        return self._sign * self._bracket(low, beyond_low, high, beyond_high)

    def _bracket(self, low: float, beyond_low: float, high: float, beyond_high: float) -> float:
        """The Illinois form of the false position; down by powers while nothing short is known."""
        if low == 0.0:
            beyond_low = Ramp(self._v, self._a, 0.0, self._limits).way - self._way
        weight_low, weight_high = beyond_low, beyond_high
        for step in range(STEPS):
            if low > 0.0 and -beyond_low <= CLOSE_S * low:
                break
            if low == 0.0:
                middle = high / 16.0
            elif step % 3 == 2:
                middle = 0.5 * (low + high)
            else:
                middle = low + (high - low) * weight_low / (weight_low - weight_high)
            beyond = self._beyond(middle)
            if beyond > 0.0:
                high, weight_high = middle, beyond
                weight_low = 0.5 * weight_low
            else:
                low, beyond_low, weight_low = middle, beyond, beyond
                weight_high = 0.5 * weight_high
        return low

    def _seconds(self, cruise: float) -> float:
        """How long the move takes, s; below 0 where it would go too far."""
        beyond = self._beyond(cruise)
        if beyond > 0.0:
            return -1.0
        first = Ramp(self._v, self._a, cruise, self._limits)
        return first.seconds - beyond / cruise + stop_time(cruise, self._limits)

    def slower(self, cruise: float, seconds: float) -> float:
        """The least velocity up to `cruise` with which it is there within `seconds`; else `cruise`."""
        low, high = 0.0, abs(cruise)
        if high == 0.0 or self._seconds(high) >= seconds:
            return cruise
        for _ in range(STEPS):
            middle = 0.5 * (low + high)
            needed = self._seconds(middle)
            if 0.0 <= needed <= seconds:
                high = middle
            else:
                low = middle
        return self._sign * high


def jog(
    position: float, velocity: float, acceleration: float, wanted: float, seconds: float, limits: MotionLimits
) -> AxisPlan:
    """At `wanted`, m/s, until `seconds` have gone by, then to rest; to the fence where that would lead beyond it."""
    plan = AxisPlan(position, velocity, acceleration)
    ramp = Ramp(velocity, acceleration, wanted, limits)
    if ramp.seconds <= seconds:
        ramp.append(plan, wanted)
        plan.push(0.0, seconds - ramp.seconds)
    else:
        begin = min(ramp.begin_s, seconds)
        hold = min(ramp.hold_s, seconds - begin)
        plan.push(ramp.first, begin)
        plan.push(0.0, hold)
        plan.push(ramp.last, seconds - begin - hold)
    add_ramp(plan, 0.0, limits)
    plan.settle(plan.position)
    if plan.keeps(limits):
        return plan
    fence = limits.high if plan.high > limits.high else limits.low
    share = min(max(abs(wanted) / limits.speed, 1e-6), 1.0)
    return move(position, velocity, acceleration, fence, limits.slowed(share))


def knot(
    position: float, velocity: float, acceleration: float, to: tuple[float, float, float], seconds: float,
    limits: MotionLimits,
) -> AxisPlan | None:  # fmt: skip
    """To position, velocity and acceleration of a stream's knot after `seconds`, then to rest; None where its hull does
    not prove that this keeps the limits.
    """
    if not seconds > 0.0:
        return None
    if velocity == 0.0 and acceleration == 0.0 and (to[0] - position) * to[1] > 0.0:
        plan = AxisPlan(position, 0.0, 0.0)
        found = _through(plan, to, _set_off(plan, to, seconds, limits), limits)
        if found is not None:
            return found
    return _through(AxisPlan(position, velocity, acceleration), to, seconds, limits)


def _through(plan: AxisPlan, to: tuple[float, float, float], seconds: float, limits: MotionLimits) -> AxisPlan | None:
    """The plan goes on to a knot, and to rest behind it; None where that does not keep the limits."""
    plan.meet(seconds, to[0], to[1], to[2])
    if not plan.keeps(limits):
        return None
    add_ramp(plan, 0.0, limits)
    plan.settle(plan.position)
    return plan if plan.keeps(limits) else None


def under_way(way: float, speed: float, seconds: float) -> float:
    """How much of `seconds` a knot `way` m from rest, m/s there, takes: as much as a steady acceleration does, so that
    nothing runs back first to have a longer way. All of it where that is next to no time.
    """
    takes = 2.0 * way / speed if way * speed > 0.0 else seconds
    return takes if SHORTEST * seconds < takes < seconds else seconds


def _set_off(plan: AxisPlan, to: tuple[float, float, float], seconds: float, limits: MotionLimits) -> float:
    """Rests until it has to set off, then takes at once the acceleration that a cubic to the knot begins with. How
    long is left, s.
    """
    way, speed = to[0] - plan.position, to[1]
    takes = under_way(way, speed, seconds)
    plan.wait(seconds - takes)
    begins = (6.0 * way / takes - 2.0 * speed) / takes
    rises = min(abs(begins) / limits.jerk, 0.1 * takes)
    plan.push(limits.jerk if begins > 0.0 else -limits.jerk, rises)
    return takes - rises
