"""The rate of a path's time: 1 as the path was made, 0 at a pause, up to 1.2; changed by the same ramps as a velocity.

A path's own motion p(s) becomes p(s(t)): velocity p' s', acceleration p'' s'^2 + p' s''. So how quickly the rate may
change is found by looking along the change: no axis may need more acceleration than it has.
"""

from collections.abc import Sequence
from typing import Final

from hil.control.plans.axis_plan import AxisPlan, MotionLimits
from hil.control.plans.ramps import add_ramp
from hil.control.trajectories.base import Trajectory

MOST_RATE: Final = 1.2
QUICKEST: Final = 25.0  # 1/s, of the rate; about 60 ms from 1 to 0
TO_QUICKEST_S: Final = 0.02  # how long the slope takes to its greatest
HALVINGS: Final = 10
LOOKS: Final = 48  # instants of a change at which its motion is looked at
NS: Final = 1e-9


class Pace:
    """Path time since a change of the rate began, s, with its rate and slope; it goes on with the last rate."""

    __slots__ = ("_plan", "_rate")

    def __init__(self, rate: float, slope: float, wanted: float, quickest: float) -> None:
        limits = MotionLimits(MOST_RATE, quickest, quickest / TO_QUICKEST_S, 0.0, 1.0)
        self._plan = AxisPlan(0.0, rate, slope)
        add_ramp(self._plan, wanted, limits)
        self._rate = wanted

    @property
    def ends(self) -> float:
        """When the rate no longer changes, s."""
        return self._plan.ends

    @property
    def way(self) -> float:
        """Path time that goes by until then, s."""
        return self._plan.position

    @property
    def rate(self) -> float:
        """Its last rate."""
        return self._rate

    def at(self, t: float) -> tuple[float, float, float]:
        """Path time gone by (s), its rate and its slope (1/s), t s after the change began."""
        if t >= self._plan.ends:
            return self._plan.position + (t - self._plan.ends) * self._rate, self._rate, 0.0
        return self._plan.at(t)


def paced(path: Trajectory, axis: int, begins_ns: int, pace: Pace, t: float) -> tuple[float, float, float]:
    """An axis' motion t s after a change of the rate began, which was at path time `begins_ns`."""
    gone, rate, slope = pace.at(t)
    whole = int(gone * 1e9)
    rest = gone - whole * NS
    p, v, a = path.at(axis, begins_ns + whole)
    v_here = v + rest * a
    return p + rest * v, v_here * rate, a * rate * rate + v_here * slope


def change_rate(
    path: Trajectory, begins_ns: Sequence[int], rate: float, slope: float, wanted: float, limits: Sequence[MotionLimits]
) -> Pace | None:
    """The quickest change of the rate from the path times `begins_ns`, ns by axis, on, that keeps what the axes may
    have of speed and acceleration; None: there is none. What the path itself has of them, it may keep.
    """
    for halving in range(HALVINGS):
        pace = Pace(rate, slope, wanted, QUICKEST / (1 << halving))
        if _kept(path, begins_ns, pace, limits):
            return pace
    return None


def _kept(path: Trajectory, begins_ns: Sequence[int], pace: Pace, limits: Sequence[MotionLimits]) -> bool:
    for look in range(LOOKS + 1):
        t = pace.ends * look / LOOKS
        gone = int(pace.at(t)[0] * 1e9)
        for axis, li in enumerate(limits):
            _, v0, a0 = path.at(axis, begins_ns[axis] + gone)
            _, v, a = paced(path, axis, begins_ns[axis], pace, t)
            if abs(v) > max(li.speed, abs(v0)) * 1.001 or abs(a) > max(li.acceleration, abs(a0)) * 1.001:
                return False
    return True
