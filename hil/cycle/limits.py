"""What the rig file says of the axes, as a tick needs it: the gate's bounds, the fault monitor's thresholds, maps."""

from drivers.protocols.base import DriveStatus
from hil.analysis.feasibility import FORCE_MARGIN, travel_margin
from hil.control.error_map import ErrorMap
from hil.control.plans.axis_plan import MotionLimits
from hil.cycle.fault_evidence import AxisLimits
from hil.cycle.gate import ForceLimits
from hil.rig.home_table import HomeConfig
from hil.rig.layout import LIMITS
from hil.rig.schema import RigConfig
from hil.rig.tables import AxisConfig, LimitsConfig

REST_WINDOW = {"linear": 3e-5, "rotary": 3e-4}  # m, rad: play of a brake, where limits.standstill is not stated
REST_COUNTS = 4.0  # encoder counts beyond it, for noise
COASTING = 2.0  # times what Coulomb friction takes to stop the axis from the speed limit
LONGEST_COASTING_S = (0.2, 2.0)  # least and most
MOTION_SPEED = 0.8  # of limits.speed
MOTION_ACCELERATION = 0.6
LEAST_SHARE = 0.02  # of limits.force: what an axis is moved with whose friction takes all the rest
WINDOW = {"linear": 1e-6, "rotary": 1e-5}  # m, rad: least, where motion.window is not stated
WINDOW_COUNTS = 10.0  # of the encoder, and at least this
JERK_S = 0.01  # from no acceleration to the greatest, at least,
JERK_PERIODS = 2.0  # and at least so many periods of the resonance
RETURN_SHARE = 0.5  # of the force that friction and gravity leave
OSCILLATION = 0.1  # of limits.following_error, where limits.oscillation is not stated


def error_maps(rig: RigConfig) -> list[ErrorMap | None]:
    """Corrections of the encoders' scales, by axis; None: it has none."""
    stated = [axis.error_map for axis in rig.axes.values()]
    return [None if each is None else ErrorMap(each.position, each.correction) for each in stated]


def force_limits(rig: RigConfig) -> list[ForceLimits]:
    """The gate's bounds from the rig file, one an axis."""
    limits = [axis.limits for axis in rig.axes.values()]
    period = rig.period_ns * 1e-9
    return [ForceLimits(li.force, li.position[0], li.position[1], li.force_rate * period) for li in limits]


def return_forces(rig: RigConfig) -> list[float]:
    """What an axis may have on its way back from beyond its travel, N (N m): what holds it and RETURN_SHARE of the
    rest.
    """
    found = []
    for axis in rig.axes.values():
        held = min(axis.model.coulomb + abs(axis.model.gravity), axis.limits.force)
        found.append(held + RETURN_SHARE * (axis.limits.force - held))
    return found


def _home_switch(home: HomeConfig | None) -> int:
    """The limit switch that the axis homes on; where its drive moves it, either may be."""
    if home is not None and home.by_itself:
        return int(LIMITS)
    if home is None or home.by != "limit":
        return 0
    return int(DriveStatus.LIMIT_LOW if home.direction < 0 else DriveStatus.LIMIT_HIGH)


def _rest_window(axis: AxisConfig) -> float:
    """How far an axis at rest may be from where it came to rest, m (rad)."""
    return axis.limits.standstill or REST_WINDOW[axis.kind] + REST_COUNTS * axis.encoder_resolution


def _coasting_s(axis: AxisConfig) -> float:
    """How long an axis may take to come to rest without torque, s."""
    least, most = LONGEST_COASTING_S
    friction = axis.model.coulomb
    return min(max(least, COASTING * axis.limits.speed * axis.model.mass / friction), most) if friction else most


def oscillation_limit(limits: LimitsConfig) -> float:
    """Amplitude of a following error that swings by itself, at which the axis is stopped, m (rad)."""
    return limits.oscillation or OSCILLATION * limits.following_error


def axis_limits(rig: RigConfig) -> list[AxisLimits]:
    """The detectors' thresholds from the rig file."""
    period, safety = rig.period_ns * 1e-9, rig.safety
    return [
        AxisLimits(
            position_low=axis.limits.position[0],
            position_high=axis.limits.position[1],
            speed=axis.limits.speed,
            following_error=axis.limits.following_error,
            oscillation=oscillation_limit(axis.limits),
            jump_step=safety.jump_margin * axis.limits.speed * period + 2.0 * axis.encoder_resolution,
            stuck_force=safety.stuck_force_fraction * axis.limits.force,
            braking=0.5 * axis.limits.force / axis.model.mass,
            force=axis.limits.force,
            switches=int(LIMITS) if axis.limits.switches else 0,
            home_switch=_home_switch(axis.home),
            rest_window=_rest_window(axis),
            coasting_s=_coasting_s(axis),
            resolution=axis.encoder_resolution,
        )
        for axis in rig.axes.values()
    ]


def motion_limits(rig: RigConfig) -> list[MotionLimits]:
    """What goals hold the axes to, where [axes.NAME.motion] does not say less: room for the loop, and the fence in
    which a damped stop from anywhere ends inside the travel.
    """
    found = []
    for axis in rig.axes.values():
        limits, stated = axis.limits, axis.motion
        margin = travel_margin(limits)
        acceleration = stated.acceleration or motion_acceleration(axis)
        settling = max(JERK_S, JERK_PERIODS / axis.model.mode_frequency_hz if axis.model.mode_frequency_hz else 0.0)
        found.append(
            MotionLimits(
                stated.speed or MOTION_SPEED * limits.speed,
                acceleration,
                stated.jerk or acceleration / settling,
                limits.position[0] + margin,
                limits.position[1] - margin,
            )
        )
    return found


def motion_windows(rig: RigConfig) -> list[float]:
    """How far from its set-point an axis is still in position, m (rad)."""
    return [
        axis.motion.window or max(WINDOW[axis.kind], WINDOW_COUNTS * axis.encoder_resolution)
        for axis in rig.axes.values()
    ]


def path_accelerations(rig: RigConfig) -> list[float]:
    """What a change of a path's rate may take, m/s^2 by axis: as much as tasks may."""
    return [motion_acceleration(axis) / MOTION_ACCELERATION for axis in rig.axes.values()]


def motion_acceleration(axis: AxisConfig) -> float:
    """Of goals: a part of what 85 % of the force leaves after friction and gravity, m/s^2 (rad/s^2); so little that a
    damped stop is shorter than a plan's own.
    """
    limits, model = axis.limits, axis.model
    left = (1.0 - FORCE_MARGIN) * limits.force - model.coulomb - abs(model.gravity)
    return min(MOTION_ACCELERATION * max(left, LEAST_SHARE * limits.force), 0.5 * limits.force) / model.mass
