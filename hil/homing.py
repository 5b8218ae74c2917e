"""The way home: one minimum-jerk move of all axes to the home position, at a fifth of the speed limits."""

import numpy as np

from hil.config import RigConfig
from hil.laws.base import Array
from hil.trajectories.segments import Segments, move

SPEED_FRACTION = 0.2
PEAK_TO_MEAN = 1.875  # peak over mean speed of a minimum-jerk move


def home_position(rig: RigConfig) -> Array:
    """The injection plan's home where there is one, else zero; inside the travel. (n_axes,), m."""
    wanted = rig.task.injection.home if rig.task.injection else [0.0] * len(rig.axes)
    limits = [axis.limits.position for axis in rig.axes.values()]
    return np.array([min(max(w, low), high) for w, (low, high) in zip(wanted, limits, strict=True)])


def home_trajectory(rig: RigConfig, start: Array) -> Segments:
    """From rest at `start` (n_axes,), m, to rest at home; a whole number of control periods."""
    home = home_position(rig)
    speed = np.array([axis.limits.speed for axis in rig.axes.values()]) * SPEED_FRACTION
    seconds = float((np.abs(home - start) * PEAK_TO_MEAN / speed).max())
    periods = max(int(seconds * 1e9) // rig.period_ns + 1, 1)
    return Segments([move(periods * rig.period_ns, start, home, 0)], final=home, repeat=False, phase_names=("homing",))
