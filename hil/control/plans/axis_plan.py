"""The plan of one axis: polynomial pieces one after another, then rest.

Instants are s from the plan's beginning. A plan is made piece by piece, each from the position, velocity and
acceleration in which the one before it ends, so that all three are continuous; `settle` ends it. What it takes of the
limits is kept while it is made: `low`, `high` (m), `speed`, `acceleration` and `jerk` bound all of its motion.
"""

import math
from typing import Final

_NEVER: Final = 1e30  # s


class MotionLimits:
    """What goals hold an axis to: m/s, m/s^2 and m/s^3 (rad), and the fence, m (rad), in which every plan ends."""

    __slots__ = ("acceleration", "high", "jerk", "low", "speed")

    def __init__(self, speed: float, acceleration: float, jerk: float, low: float, high: float) -> None:
        self.speed = speed
        self.acceleration = acceleration
        self.jerk = jerk
        self.low = low
        self.high = high

    def slowed(self, share: float) -> "MotionLimits":
        """The same fence at a fraction of the speed, above 0."""
        return MotionLimits(self.speed * share, self.acceleration, self.jerk, self.low, self.high)

    def around(self, position: float, share: float) -> "MotionLimits":
        """The same where `position`, m, is inside the fence; from outside a share of speed and acceleration, and the
        fence as wide as that, so that no plan leads further out.
        """
        if self.low <= position <= self.high:
            return self
        low, high = min(self.low, position), max(self.high, position)
        return MotionLimits(self.speed * share, self.acceleration * share, self.jerk, low, high)


Row = tuple[float, float, float, float, float, float]


class Piece:
    """Position c0 + c1 t + ... + c5 t^5, m, where t is s since it began."""

    __slots__ = ("begins", "c0", "c1", "c2", "c3", "c4", "c5", "ends")

    def __init__(self, begins: float, ends: float, row: Row) -> None:
        self.begins = begins
        self.ends = ends
        self.c0, self.c1, self.c2, self.c3, self.c4, self.c5 = row


class AxisPlan:
    """From position, velocity and acceleration on. ends: s, when it has come to rest. target: m, where."""

    __slots__ = (
        "_a",
        "_at_hand",
        "_p",
        "_v",
        "acceleration",
        "ends",
        "high",
        "jerk",
        "low",
        "pieces",
        "speed",
        "target",
    )

    def __init__(self, position: float, velocity: float, acceleration: float) -> None:
        self._p, self._v, self._a = position, velocity, acceleration
        self.pieces: list[Piece] = []
        self._at_hand = Piece(_NEVER, _NEVER, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        self.ends = 0.0
        self.target = position
        self.low = self.high = position
        self.speed = abs(velocity)
        self.acceleration = abs(acceleration)
        self.jerk = 0.0

    @property
    def position(self) -> float:
        """Where what there is of the plan ends, m."""
        return self._p

    @property
    def velocity(self) -> float:
        """With which velocity, m/s."""
        return self._v

    @property
    def last_acceleration(self) -> float:
        """With which acceleration, m/s^2."""
        return self._a

    def push(self, jerk: float, seconds: float) -> None:
        """A constant jerk, m/s^3, for a while; nothing where that is not above 0."""
        if not seconds > 0.0:
            return
        p, v, a = self._p, self._v, self._a
        self._add(seconds, (p, v, 0.5 * a, jerk / 6.0, 0.0, 0.0))
        self._p = p + seconds * (v + seconds * (0.5 * a + seconds * (jerk / 6.0)))
        self._v = v + seconds * (a + seconds * (0.5 * jerk))
        self._a = a + seconds * jerk
        if abs(jerk) > self.jerk:
            self.jerk = abs(jerk)
        if jerk != 0.0:
            self._turn(v, a, jerk, -a / jerk, seconds)
        self._reach(p, v, a, jerk, seconds)

    def _turn(self, v: float, a: float, jerk: float, at: float, seconds: float) -> None:
        """The speed is greatest where the acceleration is 0."""
        if 0.0 < at < seconds:
            fast = abs(v + at * (a + at * (0.5 * jerk)))
            if fast > self.speed:
                self.speed = fast

    def _reach(self, p: float, v: float, a: float, jerk: float, seconds: float) -> None:
        """The position turns where the velocity is 0: v + a t + jerk t^2 / 2, solved without cancellation."""
        square = a * a - 2.0 * jerk * v
        if square >= 0.0:
            root = math.sqrt(square)
            q = -(a + root) if a >= 0.0 else root - a
            if jerk != 0.0:
                self._see_turn(p, v, a, jerk, q / jerk, seconds)
            if q != 0.0:
                self._see_turn(p, v, a, jerk, 2.0 * v / q, seconds)
        self._see(self._p, self._v, self._a)

    def _see_turn(self, p: float, v: float, a: float, jerk: float, at: float, seconds: float) -> None:
        if 0.0 < at < seconds:
            self._see_place(p + at * (v + at * (0.5 * a + at * (jerk / 6.0))))

    def _see_place(self, place: float) -> None:
        if place < self.low:
            self.low = place
        elif place > self.high:
            self.high = place

    def _see(self, place: float, velocity: float, acceleration: float) -> None:
        self._see_place(place)
        if abs(velocity) > self.speed:
            self.speed = abs(velocity)
        if abs(acceleration) > self.acceleration:
            self.acceleration = abs(acceleration)

    def _add(self, seconds: float, row: Row) -> None:
        begins = self.ends
        self.ends = begins + seconds
        self.pieces.append(Piece(begins, self.ends, row))

    def meet(self, seconds: float, position: float, velocity: float, acceleration: float) -> None:
        """A quintic to another motion, `seconds` (above 0) from here. Its hull is what Bernstein's coefficients say,
        its jerk is exact.
        """
        p0, v0, a0 = self._p, self._v, self._a
        t = seconds
        d = position - p0 - v0 * t - 0.5 * a0 * (t * t)
        v = (velocity - v0 - a0 * t) * t
        a = (acceleration - a0) * (t * t)
        # of the piece over u = time / t, from 0 to 1
        b3 = 10.0 * d - 4.0 * v + 0.5 * a
        b4 = 7.0 * v - 15.0 * d - a
        b5 = 6.0 * d - 3.0 * v + 0.5 * a
        t2 = t * t
        t3 = t2 * t
        self._add(t, (p0, v0, 0.5 * a0, b3 / t3, b4 / (t3 * t), b5 / (t3 * t2)))
        self._hull(t, p0, position, v0, velocity, a0, acceleration)
        most = max(abs(6.0 * b3), abs(6.0 * b3 + 24.0 * b4 + 60.0 * b5))
        u = -0.2 * b4 / b5 if b5 != 0.0 else 0.0  # where the jerk, a parabola, turns
        if 0.0 < u < 1.0:
            most = max(most, abs(6.0 * b3 + u * (24.0 * b4 + u * (60.0 * b5))))
        most /= t3
        if most > self.jerk:
            self.jerk = most
        self._p, self._v, self._a = position, velocity, acceleration

    def _hull(self, t: float, p0: float, p1: float, v0: float, v1: float, a0: float, a1: float) -> None:
        """Control points q of the position, w of the velocity; the acceleration's are differences of these."""
        q1, q4 = p0 + v0 * t / 5.0, p1 - v1 * t / 5.0
        q2, q3 = 2.0 * q1 - p0 + a0 * (t * t) / 20.0, 2.0 * q4 - p1 + a1 * (t * t) / 20.0
        w1, w2, w3 = 5.0 * (q2 - q1) / t, 5.0 * (q3 - q2) / t, 5.0 * (q4 - q3) / t
        self._see(q1, w1, a0)
        self._see(q2, w2, 4.0 * (w2 - w1) / t)
        self._see(q3, w3, 4.0 * (w3 - w2) / t)
        self._see(q4, v1, a1)
        self._see(p1, v0, 0.0)

    def wait(self, seconds: float) -> None:
        """At rest where the plan has come to rest, for a while more."""
        if seconds > 0.0:
            self._add(seconds, (self._p, 0.0, 0.0, 0.0, 0.0, 0.0))

    def still(self, velocity: float) -> None:
        """Here the acceleration is 0 and the velocity this, m/s, except for rounding."""
        self._v, self._a = velocity, 0.0

    def settle(self, target: float) -> None:
        """From here on at rest at `target`, which is where the plan has come to, except for rounding."""
        self._p, self._v, self._a = target, 0.0, 0.0
        self.target = target
        self._see_place(target)

    def at(self, t: float) -> tuple[float, float, float]:
        """Position, velocity and acceleration, m, m/s, m/s^2, at an instant from 0 on, s."""
        if t >= self.ends:
            return self.target, 0.0, 0.0
        piece = self._at_hand
        if not piece.begins <= t < piece.ends:
            piece = self._find(t)
        t -= piece.begins
        c2, c3, c4, c5 = piece.c2, piece.c3, piece.c4, piece.c5
        return (
            piece.c0 + t * (piece.c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))),
            piece.c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * (5.0 * c5)))),
            2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * (20.0 * c5))),
        )

    def _find(self, t: float) -> Piece:
        found = self.pieces[0]
        for piece in self.pieces:
            if piece.begins > t:
                break
            found = piece
        self._at_hand = found
        return found

    def along(self, origin: float, way: float) -> "AxisPlan":
        """This plan as the share of a way, m, that an axis goes from `origin`; its target is the end of that."""
        made = AxisPlan(origin + self.pieces[0].c0 * way if self.pieces else origin, 0.0, 0.0)
        for x in self.pieces:
            row = (origin + way * x.c0, way * x.c1, way * x.c2, way * x.c3, way * x.c4, way * x.c5)
            made.pieces.append(Piece(x.begins, x.ends, row))
        made.ends = self.ends
        ends = origin + way * self.low, origin + way * self.high
        made.low, made.high = min(ends), max(ends)
        made.speed, made.acceleration = abs(way) * self.speed, abs(way) * self.acceleration
        made.jerk = abs(way) * self.jerk
        made.settle(origin + way * self.target)
        return made

    def follow(self, other: "AxisPlan", begins: float) -> None:
        """At `begins`, s, not before this one is at rest where `other` begins from rest: that one."""
        self.wait(begins - self.ends)
        for x in other.pieces:
            row = (x.c0, x.c1, x.c2, x.c3, x.c4, x.c5)
            self.pieces.append(Piece(begins + x.begins, begins + x.ends, row))
        self.ends = begins + other.ends
        self.low, self.high = min(self.low, other.low), max(self.high, other.high)
        self.speed, self.acceleration = max(self.speed, other.speed), max(self.acceleration, other.acceleration)
        self.jerk = max(self.jerk, other.jerk)
        self.settle(other.target)

    def keeps(self, limits: MotionLimits) -> bool:
        """Whether all of it is within the limits and the fence, except for rounding. One that leads back to the fence
        from outside is not.
        """
        way = ROUNDING * (limits.high - limits.low)
        return (
            self.low >= limits.low - way
            and self.high <= limits.high + way
            and self.speed <= limits.speed * (1.0 + ROUNDING)
            and self.acceleration <= limits.acceleration * (1.0 + ROUNDING)
            and self.jerk <= limits.jerk * (1.0 + JERK_ROUNDING)
        )


ROUNDING: Final = 1e-9  # of a limit
JERK_ROUNDING: Final = 1e-6
