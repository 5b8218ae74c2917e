"""What the rig file sets as limits, in the units of a tick: the gate's bounds and the fault monitor's thresholds."""

from hil.cycle.fault_monitor import AxisLimits
from hil.cycle.gate import ForceLimits
from hil.rig.schema import RigConfig

OSCILLATION = 0.1  # of limits.following_error, where limits.oscillation is not stated


def force_limits(rig: RigConfig) -> list[ForceLimits]:
    """The gate's bounds from the rig file, one an axis."""
    limits = [axis.limits for axis in rig.axes.values()]
    period = rig.period_ns * 1e-9
    return [ForceLimits(li.force, li.position[0], li.position[1], li.force_rate * period) for li in limits]


def axis_limits(rig: RigConfig) -> list[AxisLimits]:
    """The detectors' thresholds from the rig file."""
    period, safety = rig.period_ns * 1e-9, rig.safety
    return [
        AxisLimits(
            position_low=axis.limits.position[0],
            position_high=axis.limits.position[1],
            speed=axis.limits.speed,
            following_error=axis.limits.following_error,
            oscillation=axis.limits.oscillation or OSCILLATION * axis.limits.following_error,
            jump_step=safety.jump_margin * axis.limits.speed * period + 2.0 * axis.encoder_resolution,
            stuck_force=safety.stuck_force_fraction * axis.limits.force,
            braking=0.5 * axis.limits.force / axis.model.mass,
            force=axis.limits.force,
        )
        for axis in rig.axes.values()
    ]
