"""The campaign's moments where goals move the axes: each motion word, and most of all on the way into the fence."""

from collections.abc import Sequence

from hil.control.estimator.gains import per_axis
from hil.control.plans.axis_plan import MotionLimits
from hil.control.plans.ramps import stop_time
from hil.cycle.goal import MotionWord
from hil.cycle.limits import motion_limits
from hil.cycle.state_machine import State
from hil.cycle.tick import CommandKind
from hil.rig.schema import RigConfig
from hil.studies.fault_campaign.checkpoints import Checkpoint, task_phases
from hil.studies.fault_campaign.clients import way_into_the_fence

EVERY_S = 0.005  # between moments while the axes brake in front of the fence
MOST = 12  # of these moments
SETTLE_TICKS = 50  # at rest, behind the way
LONGEST_S = 5.0  # of a path, before a moment
SHARES = (0.25, 0.5, 0.75)  # of the way


def _braking(limits: Sequence[MotionLimits], period: float) -> list[int]:
    """Ticks before the end of a way, while the axes brake."""
    longest = max(stop_time(li.speed, li) for li in limits)
    return [round(k * EVERY_S / period) for k in range(min(MOST, int(longest / EVERY_S) + 1), 0, -1)]


def motion_points(rig: RigConfig) -> list[Checkpoint]:
    """All moments of motion by goals that the campaign looks at."""
    start = per_axis(rig.plant.initial_position, len(rig.axes)).tolist()
    period = rig.period_ns * 1e-9
    way = round(way_into_the_fence(rig, start)[0].ends / period)
    braking = _braking(motion_limits(rig), period)
    points = [_point("hold", "HOLD", 100, MotionWord.HOLD)]
    for motion, word in (("move", MotionWord.MOVE), ("jog", MotionWord.JOG), ("stream", MotionWord.STREAM)):
        name = motion.upper()
        points.append(_point(motion, f"{name}, begun", 3, word))
        points += [_point(motion, f"{name}, {share:.0%} of the way", round(share * way), word) for share in SHARES]
        points += [_point(motion, f"{name}, {k} ticks before the fence", way - k, word) for k in braking]
        points.append(_point(motion, f"{name}, at the fence", way + SETTLE_TICKS))
    points += [_point("halt", f"HALT, {k} ticks ago", way // 2 + k, MotionWord.MOVE) for k in (1, 5)]
    phases = [phase for phase in task_phases(rig) if phase[1] * period < LONGEST_S]
    for name, ticks in phases[:: max(1, len(phases) // 4)]:
        points.append(_point("path", f"PATH {name}", ticks, MotionWord.PATH))
    paused = phases[len(phases) // 2][1]
    for k in (5, 200):
        points.append(_point(f"paused {paused}", f"PAUSED, {k} ticks ago", paused + k, MotionWord.PAUSED))
    return points


def _point(motion: str, name: str, ticks: int, word: MotionWord = MotionWord.NONE) -> Checkpoint:
    return Checkpoint(name, State.ACTIVE, ticks, CommandKind.ACTIVATE_HOLD, motion=motion, word=word)
