"""Ramps: from any velocity and acceleration to a velocity without acceleration, as quickly as acceleration and jerk
allow: jerk, hold, jerk. One square root.
"""

import math

from hil.control.plans.axis_plan import AxisPlan, MotionLimits


class Ramp:
    """first, last: jerks, m/s^3, for begin_s and end_s; between them the acceleration stays for hold_s. way: m."""

    __slots__ = ("begin_s", "end_s", "first", "hold_s", "last", "way")

    def __init__(self, v0: float, a0: float, v1: float, limits: MotionLimits) -> None:
        most, jerk = limits.acceleration, limits.jerk
        # Towards v1 as soon as the acceleration at hand is gone; all below is seen from that side.
        sign = 1.0 if v1 - v0 - a0 * abs(a0) / (2.0 * jerk) >= 0.0 else -1.0
        gain, a = sign * (v1 - v0), sign * a0
        square = jerk * gain + 0.5 * a * a
        peak = math.sqrt(square) if square > 0.0 else 0.0
        self.hold_s = 0.0
        if a > most:  # of a goal that wants less than what is in force
            peak = most
            self.hold_s = max((gain - a * a / (2.0 * jerk)) / most, 0.0)
        elif peak > most:
            peak = most
            self.hold_s = max((gain - (2.0 * most * most - a * a) / (2.0 * jerk)) / most, 0.0)
        self.begin_s = abs(peak - a) / jerk
        self.end_s = peak / jerk
        self.first = sign * (jerk if peak >= a else -jerk)
        self.last = -sign * jerk
        self.way = self._way(v0, a0, v1)

    def _way(self, v0: float, a0: float, v1: float) -> float:
        """From either end to the stretch of constant acceleration, and along that."""
        t, h, e = self.begin_s, self.hold_s, self.end_s
        early = t * (v0 + t * (0.5 * a0 + t * (self.first / 6.0)))
        late = e * (v1 + e * e * (self.last / 6.0))  # backwards in time: e from rest of the acceleration
        at = v0 + t * (a0 + t * (0.5 * self.first))
        held = h * (at + 0.5 * h * (a0 + t * self.first))
        return early + held + late

    @property
    def seconds(self) -> float:
        """How long it lasts."""
        return self.begin_s + self.hold_s + self.end_s

    def append(self, plan: AxisPlan, velocity: float) -> None:
        """At the end of `plan`, from the motion it was made for; velocity: the one it was made for, m/s."""
        plan.push(self.first, self.begin_s)
        plan.push(0.0, self.hold_s)
        plan.push(self.last, self.end_s)
        plan.still(velocity)


def stop_way(speed: float, limits: MotionLimits) -> float:
    """What a ramp from a speed (m/s) without acceleration to rest takes, or one from rest to it, m."""
    return 0.5 * speed * stop_time(speed, limits)


def stop_time(speed: float, limits: MotionLimits) -> float:
    """How long that takes, s."""
    most, jerk = limits.acceleration, limits.jerk
    if speed * jerk <= most * most:
        return 2.0 * math.sqrt(speed / jerk)
    return speed / most + most / jerk


def add_ramp(plan: AxisPlan, velocity: float, limits: MotionLimits) -> None:
    """From how `plan` ends to a velocity, m/s."""
    Ramp(plan.velocity, plan.last_acceleration, velocity, limits).append(plan, velocity)
