"""A stream of knots, one axis: through each knot, and to rest behind the last one.

A knot says where and how fast the axis is to be at an instant. Its acceleration follows from its neighbours: from the
speed of the one before while it is the newest, from places and speeds of both as soon as the next has come. So a new
knot plans the way to the one before again, where that has time left, and goes on from there.
"""

from typing import Final, NamedTuple

from hil.control.plans.axis_plan import MotionLimits
from hil.control.plans.course import Course, Stretch
from hil.control.plans.moves import knot, under_way

NS: Final = 1e-9
MOST_AHEAD: Final = 3  # knots that the axis has not come to; the next is met from where the axis is
FITS: Final = 0.25  # of the speeds' rise: places that ask for another acceleration do not belong to these speeds


class Knot(NamedTuple):
    """due_ns: on the course's clock. place, speed: m and m/s. after: s under way since the one before, 0 where there is
    none. rise: of the speed since then, m/s^2. arc: how far off this speed's line that one lies, over after^2, m/s^2.
    """

    due_ns: int = 0
    place: float = 0.0
    speed: float = 0.0
    rise: float = 0.0
    after: float = 0.0
    arc: float = 0.0

    def next(self, due_ns: int, place: float, speed: float) -> "Knot":
        """The one that comes behind this, or behind a motion that was this at its time."""
        after = (due_ns - self.due_ns) * NS
        if after <= 0.0:
            return Knot(due_ns, place, speed)
        if self.speed == 0.0:
            after = under_way(place - self.place, speed, after)
        arc = (self.place - place + speed * after) / (after * after)
        return Knot(due_ns, place, speed, (speed - self.speed) / after, after, arc)

    def bend(self, later: "Knot", most: float) -> float:
        """Its acceleration between the knot before and a later one, m/s^2, at most `most`."""
        if not self.after:
            return _within(later.rise, most)
        by_speeds = (self.rise * later.after + later.rise * self.after) / (self.after + later.after)
        found = self._quintic(later)
        if abs(found - by_speeds) > FITS * max(abs(self.rise), abs(later.rise)):
            found = by_speeds
        return _within(found, most)

    def _quintic(self, later: "Knot") -> float:
        """Acceleration here of the quintic with the places and speeds of this knot, the one before, and a later one,
        m/s^2: x + v t + a t^2 / 2 + c t^3 + d t^4 + e t^5.
        """
        to, back = later.after, -self.after
        arc = (later.place - self.place - self.speed * to) / (to * to)
        bent = ((later.rise - 2.0 * arc) / to - (self.rise - 2.0 * self.arc) / back) / (to - back)
        skew = ((later.rise - 3.0 * arc) - (self.rise - 3.0 * self.arc)) / (to - back)
        fifth = (2.0 * skew - (to + back) * bent) / ((to - back) * (to - back))
        fourth = (bent - 3.0 * fifth * (to + back)) / 2.0
        return 2.0 * (to * to * (fourth + 2.0 * fifth * to) - (later.rise - 3.0 * arc))


def _within(value: float, most: float) -> float:
    return max(-most, min(most, value))


def follow_on(course: Course, axis: int, last: Knot, new: Knot, base_ns: int, limits: MotionLimits) -> int:
    """Where the plan to the new knot begins, ns: at the last one where the axis is still on its way there, which is
    planned again for it; else at `base_ns`.
    """
    if not (new.after and base_ns < last.due_ns) or course.ahead(axis, base_ns) >= MOST_AHEAD:
        return base_ns
    newest = course.newest(axis)
    begins = max(base_ns, newest.begins) if newest.follows else base_ns
    state = course.at(axis, begins)
    to = last.place, last.speed, last.bend(new, limits.acceleration)
    made = knot(*state, to, (last.due_ns - begins) * NS, limits)
    if made is not None:
        course.add(axis, Stretch(begins, made, follows=newest.follows and begins == newest.begins))
    return last.due_ns
