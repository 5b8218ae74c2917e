"""The way home: one minimum-jerk move of all axes to the home position, at a fifth of the speed limits."""

from hil.control.trajectories import Plan
from hil.control.trajectories.segments import Segments, Values, move, rest
from hil.rig.schema import RigConfig

SPEED_FRACTION = 0.2
PEAK_TO_MEAN = 1.875  # peak over mean speed of a minimum-jerk move


def home_position(rig: RigConfig) -> list[float]:
    """The injection plan's home where there is one, else zero; inside the travel. By axis, m."""
    wanted = rig.task.injection.home if rig.task.injection else [0.0] * len(rig.axes)
    limits = [axis.limits.position for axis in rig.axes.values()]
    return [min(max(w, low), high) for w, (low, high) in zip(wanted, limits, strict=True)]


def plan_homing(rig: RigConfig) -> Plan:
    """From rest anywhere to rest at home; a whole number of control periods."""
    home, period_ns = home_position(rig), rig.period_ns
    speeds = [axis.limits.speed * SPEED_FRACTION for axis in rig.axes.values()]

    def begin(start: Values) -> Segments:
        ways = zip(start, home, speeds, strict=True)
        seconds = max(abs(there - here) * PEAK_TO_MEAN / speed for here, there, speed in ways)
        periods = int(seconds * 1e9) // period_ns + 1
        there = [move(periods * period_ns, start, home), rest(0, home)]
        return Segments(there, repeat=False, phase_names=("homing",))

    return begin
