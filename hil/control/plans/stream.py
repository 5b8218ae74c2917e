"""A stream of knots, one axis: through each knot, and to rest behind the last one.

A knot says where and how fast the axis is to be at an instant. Its acceleration follows from its neighbours' speeds:
from the one before while it is the newest, from both as soon as the next has come. So a new knot plans the way to the
one before again, where that has time left, and goes on from there.
"""

from typing import Final, NamedTuple

from hil.control.plans.axis_plan import MotionLimits
from hil.control.plans.course import Course, Stretch
from hil.control.plans.moves import knot

NS: Final = 1e-9
MOST_AHEAD: Final = 3  # knots that the axis has not come to; the next is met from where the axis is


class Knot(NamedTuple):
    """due_ns: on the course's clock. place, speed: m and m/s. streams: it follows another one; rise: of the speed since
    then, m/s^2, and after: how long, s.
    """

    due_ns: int = 0
    place: float = 0.0
    speed: float = 0.0
    streams: bool = False
    rise: float = 0.0
    after: float = 0.0

    def next(self, due_ns: int, place: float, speed: float, *, streams: bool) -> "Knot":
        """The one that comes behind this; streams: the axis has not come to rest in between."""
        after = (due_ns - self.due_ns) * NS
        if not streams or after <= 0.0:
            return Knot(due_ns, place, speed)
        return Knot(due_ns, place, speed, True, (speed - self.speed) / after, after)

    def bend(self, later: "Knot", most: float) -> float:
        """Its acceleration between the knot before and a later one, m/s^2, at most `most`."""
        if not self.streams:
            return _within(later.rise, most)
        whole = self.after + later.after
        return _within((self.rise * later.after + later.rise * self.after) / whole, most)


def _within(value: float, most: float) -> float:
    return max(-most, min(most, value))


def follow_on(course: Course, axis: int, last: Knot, new: Knot, base_ns: int, limits: MotionLimits) -> int:
    """Where the plan to the new knot begins, ns: at the last one where the axis is still on its way there, which is
    planned again for it; else at `base_ns`.
    """
    if not (new.streams and base_ns < last.due_ns) or course.ahead(axis, base_ns) >= MOST_AHEAD:
        return base_ns
    newest = course.newest(axis)
    begins = max(base_ns, newest.begins) if newest.follows else base_ns
    state = course.at(axis, begins)
    to = last.place, last.speed, last.bend(new, limits.acceleration)
    made = knot(*state, to, (last.due_ns - begins) * NS, limits)
    if made is not None:
        course.add(axis, Stretch(begins, made, follows=newest.follows and begins == newest.begins))
    return last.due_ns
