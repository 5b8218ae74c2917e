"""Moves of several axes: begun and ended together, or along the straight line between two places."""

from collections.abc import Sequence

from hil.control.plans.axis_plan import AxisPlan, MotionLimits
from hil.control.plans.moves import add_move, halt, move

State = tuple[float, float, float]  # position, velocity, acceleration of an axis


def moves(states: Sequence[State], targets: Sequence[float], limits: Sequence[MotionLimits]) -> list[AxisPlan]:
    """Each axis to its target, m, the quicker ones slowed so that they arrive with the slowest."""
    plans = [move(p, v, a, there, li) for (p, v, a), there, li in zip(states, targets, limits, strict=True)]
    longest = max([plan.ends for plan in plans])
    for axis, plan in enumerate(plans):
        if plan.ends < longest:
            p, v, a = states[axis]
            plans[axis] = move(p, v, a, targets[axis], limits[axis], longest)
    return plans


def line(states: Sequence[State], targets: Sequence[float], limits: Sequence[MotionLimits]) -> list[AxisPlan]:
    """To the targets, m, along a straight line; axes that move come to rest first."""
    plans = [halt(p, v, a, li) for (p, v, a), li in zip(states, limits, strict=True)]
    begins = max([plan.ends for plan in plans])
    ways = [there - plan.target for there, plan in zip(targets, plans, strict=True)]
    share = _share(ways, limits)
    for plan, way, there in zip(plans, ways, targets, strict=True):
        part = share.along(plan.target, way)
        part.settle(there)
        plan.follow(part, begins)
    return plans


def _share(ways: Sequence[float], limits: Sequence[MotionLimits]) -> AxisPlan:
    """From 0 to 1 as quickly as every axis can go its way, m."""
    speed = acceleration = jerk = 1e12  # of an axis that stays
    for way, li in zip(ways, limits, strict=True):
        if way != 0.0:
            speed = min(speed, li.speed / abs(way))
            acceleration = min(acceleration, li.acceleration / abs(way))
            jerk = min(jerk, li.jerk / abs(way))
    plan = AxisPlan(0.0, 0.0, 0.0)
    if speed == 1e12:
        plan.settle(1.0)
        return plan
    return add_move(plan, 1.0, MotionLimits(speed, acceleration, jerk, 0.0, 1.0))
