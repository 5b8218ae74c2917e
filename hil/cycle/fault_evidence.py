"""What the detectors hold their measurements against, and what they leave of a fault they have found."""

from typing import NamedTuple


class AxisLimits(NamedTuple):
    """One axis' thresholds, SI units."""

    position_low: float
    position_high: float
    speed: float
    following_error: float
    oscillation: float  # amplitude of the following error, m
    jump_step: float  # m a sample may differ from the last one per period
    stuck_force: float
    braking: float  # m/s^2 the force limit is good for, halved
    force: float
    switches: int = 0  # DriveStatus bits of its limit switches; 0: it has none
    home_switch: int = 0  # of these, those it homes on
    rest_window: float = 3e-5  # m around where it rests
    coasting_s: float = 0.2  # longest that friction takes to stop it
    resolution: float = 1e-7  # m per count


class Evidence(NamedTuple):
    """What a detector measured of a fault, and the limit it was held against, in the unit that its text names.

    fault: a Fault. axis: 0-based, or NO_AXIS.
    """

    fault: int
    axis: int
    value: float
    limit: float
