"""Goals of the worst kind for the plans of hil/control/plans: any place, any instant of the plan in hand, any limit.

python -m tests.support.hostile_goals [--goals N] [--seeds N]
    the nightly lane: 10^6 goals of each of five seeds, and one SHA-256 of all set-points
"""

import argparse
import hashlib
import random
import struct
import sys
from typing import NamedTuple

from hil.control.plans.axis_plan import JERK_ROUNDING, ROUNDING, AxisPlan, MotionLimits, Piece
from hil.control.plans.moves import halt, jog, knot, move

AXES = (
    MotionLimits(0.08, 1.5, 60.0, -0.01, 0.012),
    MotionLimits(1.0, 20.0, 1000.0, -0.3, 0.3),
    MotionLimits(2e-3, 0.05, 2.0, -1e-3, 5e-3),
    MotionLimits(3.0, 40.0, 4000.0, -3.1, 3.1),
    MotionLimits(0.02, 5.0, 5000.0, 0.0, 1e-4),
)
JOIN = 1e-9  # of a limit: what pieces may miss each other by, as doubles do


class Outcome(NamedTuple):
    """What came of the goals of a seed. limited: knots whose hull did not prove the limits."""

    goals: int
    limited: int
    knots: int
    sha256: str


class _Hostile:
    def __init__(self, seed: int) -> None:
        self.draw = random.Random(seed)
        self.limits = AXES[seed % len(AXES)]
        self.travel = self.limits.high - self.limits.low
        self.plan = halt(0.5 * (self.limits.low + self.limits.high), 0.0, 0.0, self.limits)
        self.limited = self.knots = 0

    def share(self) -> float:
        return 2.0 * self.draw.random() - 1.0

    def instant(self) -> float:
        ends, some = self.plan.ends, self.draw.random()
        return self.draw.choice((0.0, 1e-3, some * ends, some * ends, some * 0.02, ends, ends + 1e-3, some * 1e-6))

    def place(self, position: float) -> float:
        """Ends of the fence, anywhere, here, the same again, nearer than any encoder sees."""
        near = position + self.share() * self.travel * 10.0 ** -self.draw.randrange(1, 17)
        anywhere = self.limits.low + self.draw.random() * self.travel
        here = (self.limits.low, self.limits.high, anywhere, near, near, position, self.plan.target)
        return min(max(self.draw.choice(here), self.limits.low), self.limits.high)

    def next(self, p: float, v: float, a: float) -> AxisPlan:
        limits, kind = self.limits, self.draw.choice("hmmmmjjkkk")
        if kind == "h":
            return halt(p, v, a, limits)
        if kind == "m":
            slow = limits.slowed(self.draw.choice((1.0, 1.0, 0.5, 0.1, 1e-3, 1e-6 + self.draw.random())))
            seconds = self.draw.choice((0.0, 0.0, self.draw.random()))
            chosen = slow if abs(v) <= slow.speed and slow.speed <= limits.speed else limits
            return move(p, v, a, self.place(p), chosen, seconds)
        if kind == "j":
            speed = limits.speed * self.draw.choice((1.0, -1.0, self.share(), 1e-9, 0.0))
            return jog(p, v, a, speed, self.draw.choice((0.1, 0.5, 1e-3, self.draw.random())), limits)
        return self._knot(p, v, a)

    def _knot(self, p: float, v: float, a: float) -> AxisPlan:
        """Of a path that is possible, mostly."""
        limits = self.limits
        due = self.draw.choice((1e-3, 0.02, 0.1, 0.2 * self.draw.random() + 1e-6))
        wild = self.draw.choice((0.1, 0.3, 3.0))
        turn = self.share() * wild * limits.acceleration
        to = (
            p + due * (v + 0.5 * due * (a + 0.3 * turn)),
            v + due * (a + 0.5 * turn),
            self.share() * limits.acceleration,
        )
        place = min(max(to[0], limits.low), limits.high)
        made = knot(p, v, a, (place, to[1], to[2] if wild > 1.0 else a), due, limits)
        self.knots += 1
        self.limited += made is None
        return move(p, v, a, place, limits) if made is None else made

    def check(self, plan: AxisPlan, state: tuple[float, float, float]) -> None:
        limits = self.limits
        assert plan.at(0.0) == state or not plan.pieces, (plan.at(0.0), state)
        assert plan.at(plan.ends) == (plan.target, 0.0, 0.0)
        scales = (self.travel, limits.speed, limits.acceleration)
        for piece in plan.pieces:
            ends = plan.at(piece.ends)
            last = _end_of(piece)
            for name, before, after, scale in zip("pva", last, ends, scales, strict=True):
                assert abs(before - after) <= JOIN * scale, (name, before, after, piece.ends, plan.ends)
        for look in range(9):
            p, v, a = plan.at(plan.ends * look / 8.0)
            slack = ROUNDING * self.travel
            assert limits.low - slack <= p <= limits.high + slack
            assert abs(v) <= limits.speed * (1.0 + ROUNDING)
            assert abs(a) <= limits.acceleration * (1.0 + ROUNDING)
        assert plan.jerk <= limits.jerk * (1.0 + JERK_ROUNDING)


def _end_of(piece: Piece) -> tuple[float, float, float]:
    t = piece.ends - piece.begins
    c0, c1, c2, c3, c4, c5 = piece.c0, piece.c1, piece.c2, piece.c3, piece.c4, piece.c5
    return (
        c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))),
        c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))),
        2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5)),
    )


def hostile(seed: int, goals: int) -> Outcome:
    """That many goals, one after another, each taken at some instant of the plan of the one before. Raises
    AssertionError where a plan breaks a limit or jumps, or one is refused though it need not be.
    """
    source, digest = _Hostile(seed), hashlib.sha256()
    for _ in range(goals):
        state = source.plan.at(source.instant())
        plan = source.next(*state)
        assert plan.keeps(source.limits), (state, plan.low, plan.high, plan.speed, plan.acceleration)
        source.check(plan, state)
        digest.update(struct.pack("<4d", *state, plan.ends))
        source.plan = plan
    return Outcome(goals, source.limited, source.knots, digest.hexdigest())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=int, default=1_000_000)
    parser.add_argument("--seeds", type=int, default=5)
    arguments = parser.parse_args()
    for seed in range(arguments.seeds):
        print(seed, hostile(seed, arguments.goals))
    print(sys.version)


if __name__ == "__main__":
    main()
