"""The motion plan of Xu, Cai, Zou (2013), section 2.1 and Figure 1, over a row of cells.

q_a (home) -> q_b (within the focal range) -> per cell: q_s (start) -> q_c (contact, greatest speed) -> q_d (rest,
inject) -> back to q_s -> the next cell's q_s; after the last cell home again. Position, velocity and acceleration are
continuous.
"""

from collections.abc import Callable

import numpy as np

from hil.config import InjectionConfig
from hil.laws.base import Array
from hil.trajectories.segments import Segment, Segments, move, quintic, rest

PHASES = ("home", "approach", "transfer", "strike", "pierce", "dwell", "withdraw", "return", "done")
HOME, APPROACH, TRANSFER, STRIKE, PIERCE, DWELL, WITHDRAW, RETURN, _ = range(len(PHASES))
AT_HOME = 1e-6  # m: nearer than this the plan starts from where the stage stands
# Contact speed over mean speed for which a quintic without acceleration at contact is fastest there.
SPEED_RATIO = (5 / 3, 5 / 2)
ON_LINE = 1e-9  # m


def _contact_velocity(plan: InjectionConfig) -> tuple[Array, float]:
    """Velocity at contact (n_axes,) and the fraction of the strike's time until then. Raises ValueError."""
    start, contact, end = (np.array(p) for p in (plan.start, plan.contact, plan.end))
    path = end - start
    length = float(np.sqrt(sum(float(x) * float(x) for x in path)))
    if length == 0.0:
        raise ValueError(f"task.injection.end = {plan.end}: it must differ from start")
    direction = path / length
    fraction = sum(float(x) for x in (contact - start) * direction) / length
    off_line = float(np.max(np.abs(start + fraction * path - contact)))
    if not 0.0 < fraction < 1.0 or off_line > ON_LINE:
        raise ValueError(f"task.injection.contact = {plan.contact}: it must lie between start and end, on their line")
    low, high = (ratio * length / plan.strike_s for ratio in SPEED_RATIO)
    if not low <= plan.contact_speed <= high:
        raise ValueError(
            f"task.injection.contact_speed = {plan.contact_speed} m/s: for {length:.6g} m in strike_s = "
            f"{plan.strike_s} s it must be in [{low:.6g}, {high:.6g}] m/s to be greatest at contact"
        )
    return plan.contact_speed * direction, fraction


def _cell(plan: InjectionConfig, index: int, ns: Callable[[float], int]) -> list[Segment]:
    velocity, fraction = _contact_velocity(plan)
    offset = index * np.array(plan.pitch)
    start, contact, end = (np.array(p) + offset for p in (plan.start, plan.contact, plan.end))
    zero = np.zeros(len(start))
    to_contact = ns(fraction * plan.strike_s)
    inside = max(ns(plan.strike_s) - to_contact, ns(0.0))
    return [
        quintic(to_contact, (start, zero, zero), (contact, velocity, zero), STRIKE),
        quintic(inside, (contact, velocity, zero), (end, zero, zero), PIERCE),
        rest(ns(plan.dwell_s), end, DWELL),
        move(ns(plan.withdraw_s), end, start, WITHDRAW),
    ]


def injection(plan: InjectionConfig, start_position: Array, ns: Callable[[float], int]) -> tuple[Segments, int]:
    """The plan from `start_position`, and the task time at which the stage is in the focal range.

    `ns` turns seconds into nanoseconds (a whole number of periods, at least one). Raises ValueError naming key, value
    and allowed range when the contact point or its speed cannot be.
    """
    home, focal, pitch = np.array(plan.home), np.array(plan.focal), np.array(plan.pitch)
    here, segments = start_position, []
    if float(np.max(np.abs(here - home))) > AT_HOME:
        segments.append(move(ns(plan.approach_s), here, home, HOME))
        here = home
    segments.append(move(ns(plan.approach_s), here, focal, APPROACH))
    in_focus = sum(segment.duration_ns for segment in segments)
    here = focal
    for index in range(plan.cells):
        first = np.array(plan.start) + index * pitch
        segments.append(move(ns(plan.transfer_s), here, first, TRANSFER))
        segments.extend(_cell(plan, index, ns))
        here = first
    segments.append(move(ns(plan.approach_s), here, home, RETURN))
    return Segments(segments, final=home, repeat=False, phase_names=PHASES), in_focus
