"""ruckig's time-optimal moves and ours, from drawn states of motion."""

import random
from collections.abc import Iterator

import ruckig

from hil.control.plans.axis_plan import MotionLimits
from hil.control.plans.moves import halt, move
from tests.peers.table import DIFFERS, PASSED, Row
from tests.support.hostile_goals import AXES

SLOWER_S = 4e-3  # at most
_EQUAL = 1e-9


def ruckigs(p: float, v: float, a: float, target: float, limits: MotionLimits) -> ruckig.Trajectory:
    """The quickest move."""
    asked, made = ruckig.InputParameter(1), ruckig.Trajectory(1)
    asked.current_position, asked.current_velocity, asked.current_acceleration = [p], [v], [a]
    asked.target_position, asked.max_velocity = [target], [limits.speed]
    asked.max_acceleration, asked.max_jerk = [limits.acceleration], [limits.jerk]
    assert ruckig.Ruckig(1).calculate(asked, made) in (ruckig.Result.Working, ruckig.Result.Finished)
    return made


def rows(number: int) -> Iterator[Row]:
    """number: of moves, on all axes together; a row an axis."""
    for axis, limits in enumerate(AXES):
        draw, plan, worst, late = random.Random(axis), halt(0.0, 0.0, 0.0, limits), 0.0, 0.0
        for _ in range(number // len(AXES)):
            state = plan.at(draw.choice((plan.ends, draw.random() * plan.ends)))
            target = limits.low + draw.random() * (limits.high - limits.low)
            plan, best = move(*state, target, limits), ruckigs(*state, target, limits)
            late = max(late, plan.ends - best.duration)
            worst = max(worst, abs(plan.at(plan.ends)[0] - best.at_time(best.duration)[0][0]))
        told = f"{number // len(AXES)} moves: at most {late * 1e3:.3g} ms slower, ends {worst:.1e} apart"
        equal = late <= SLOWER_S and worst <= _EQUAL
        yield Row("ruckig", f"moves of axis {axis}", PASSED if equal else DIFFERS, told)
