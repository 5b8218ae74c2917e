"""The motion plan of Xu, Cai, Zou (2013), section 2.1 and Figure 1, over a row of cells.

q_a (home) -> q_b (within the focal range) -> per cell: q_s (start) -> q_c (contact, greatest speed) -> q_d (rest,
inject) -> back to q_s -> the next cell's q_s; after the last cell home again. Position, velocity and acceleration are
continuous.
"""

import math
from collections.abc import Callable, Sequence
from operator import add, mul, sub

from hil.control.trajectories.base import Plan
from hil.control.trajectories.segments import Segment, Segments, Values, move, quintic, rest
from hil.rig.schema import InjectionConfig

PHASES = ("home", "approach", "transfer", "strike", "pierce", "dwell", "withdraw", "return", "done")
HOME, APPROACH, TRANSFER, STRIKE, PIERCE, DWELL, WITHDRAW, RETURN, DONE = range(len(PHASES))
AT_HOME = 1e-6  # m: nearer than this the plan starts from where the stage stands
# Contact speed over mean speed for which a quintic without acceleration at contact is fastest there.
SPEED_RATIO = (5 / 3, 5 / 2)
ON_LINE = 1e-9  # m


def _contact_velocity(plan: InjectionConfig) -> tuple[list[float], float]:
    """Velocity at contact, m/s by axis, and the fraction of the strike's time until then. Raises ValueError."""
    path = list(map(sub, plan.end, plan.start))
    length = math.sqrt(sum(x * x for x in path))
    if length == 0.0:
        raise ValueError(f"task.injection.end = {plan.end}: it must differ from start")
    direction = [x / length for x in path]
    fraction = sum(map(mul, map(sub, plan.contact, plan.start), direction)) / length
    off_line = max(abs(s + fraction * x - c) for s, x, c in zip(plan.start, path, plan.contact, strict=True))
    if not 0.0 < fraction < 1.0 or off_line > ON_LINE:
        raise ValueError(f"task.injection.contact = {plan.contact}: it must lie between start and end, on their line")
    low, high = (ratio * length / plan.strike_s for ratio in SPEED_RATIO)
    if not low <= plan.contact_speed <= high:
        raise ValueError(
            f"task.injection.contact_speed = {plan.contact_speed} m/s: for {length:.6g} m in strike_s = "
            f"{plan.strike_s} s it must be in [{low:.6g}, {high:.6g}] m/s to be greatest at contact"
        )
    return [plan.contact_speed * x for x in direction], fraction


def _cells(plan: InjectionConfig, ns: Callable[[float], int]) -> list[Segment]:
    """From the focal position through all cells. Raises ValueError."""
    velocity, fraction = _contact_velocity(plan)
    zero = [0.0] * len(velocity)
    to_contact = ns(fraction * plan.strike_s)
    inside = max(ns(plan.strike_s) - to_contact, ns(0.0))
    here, segments = plan.focal, []
    for index in range(plan.cells):
        offset = [index * step for step in plan.pitch]
        start, contact, end = (list(map(add, point, offset)) for point in (plan.start, plan.contact, plan.end))
        segments += [
            move(ns(plan.transfer_s), here, start, TRANSFER),
            quintic(to_contact, (start, zero, zero), (contact, velocity, zero), STRIKE),
            quintic(inside, (contact, velocity, zero), (end, zero, zero), PIERCE),
            rest(ns(plan.dwell_s), end, DWELL),
            move(ns(plan.withdraw_s), end, start, WITHDRAW),
        ]
        here = start
    return [*segments, move(ns(plan.approach_s), here, plan.home, RETURN), rest(0, plan.home, DONE)]


def injection(plan: InjectionConfig, ns: Callable[[float], int], settle_ns: int) -> Plan:
    """The plan, with statistics from `settle_ns` after the stage has come into the focal range.

    `ns` turns seconds into nanoseconds (a whole number of periods, at least one). Raises ValueError naming key, value
    and allowed range when the contact point or its speed cannot be.
    """
    return OverCells(plan.home, plan.focal, ns(plan.approach_s), settle_ns, _cells(plan, ns))


class OverCells:
    """The Plan over a row of cells: from the focal position on made beforehand."""

    def __init__(self, home: Values, focal: Values, approach_ns: int, settle_ns: int, cells: Sequence[Segment]) -> None:
        self.home, self.focal, self.cells = home, focal, cells
        self.approach_ns, self.settle_ns = approach_ns, settle_ns
        self._from_home = move(approach_ns, home, focal, APPROACH)

    def __call__(self, start: Values) -> Segments:
        """The trajectory from rest at `start`, m by axis."""
        if max(map(abs, map(sub, start, self.home))) > AT_HOME:
            entry = [move(self.approach_ns, start, self.home, HOME), self._from_home]
        else:
            entry = [move(self.approach_ns, start, self.focal, APPROACH)]
        trajectory = Segments([*entry, *self.cells], repeat=False, phase_names=PHASES)
        trajectory.steady_from_ns = len(entry) * self.approach_ns + self.settle_ns
        return trajectory
