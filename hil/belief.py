"""What the rig file believes, as the arrays and limits the control cycle and batches of plants work with."""

from functools import partial

import numpy as np

from hil.control.laws.base import LawInputs, Model, Reference
from hil.cycle.fault_monitor import AxisLimits
from hil.cycle.gate import ForceLimits
from hil.rig.schema import RigConfig


def rig_model(rig: RigConfig) -> Model:
    """The rig file's nominal belief as arrays (n_axes,). The file's gravity acts on the axis; the model's holds against
    it.
    """
    axes = [axis.model for axis in rig.axes.values()]
    return Model(
        mass=np.array([a.mass for a in axes]),
        coulomb=np.array([a.coulomb for a in axes]),
        viscous=np.array([a.viscous for a in axes]),
        quadratic=np.array([a.quadratic for a in axes]),
        gravity=np.array([-a.gravity for a in axes]) + 0.0,
    )


def blank_inputs(shape: tuple[int, ...]) -> LawInputs:
    """LawInputs of zeros, arrays of `shape`."""
    zeros = partial(np.zeros, shape)

    def rest() -> Reference:
        return Reference(zeros(), zeros(), zeros())

    return LawInputs(
        position=zeros(), fresh=zeros(), sample=rest(), sample_interval=zeros(), ahead=zeros(),
        position_estimate=zeros(), velocity_estimate=zeros(), disturbance_estimate=zeros(), start=rest(), end=rest(),
        mean_velocity=zeros(), mean_acceleration=zeros(), mean_sign=zeros(), force_last=zeros(), force_before=zeros(),
    )  # fmt: skip


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
            jump_step=safety.jump_margin * axis.limits.speed * period + 2.0 * axis.encoder_resolution,
            stuck_force=safety.stuck_force_fraction * axis.limits.force,
            braking=0.5 * axis.limits.force / axis.model.mass,
        )
        for axis in rig.axes.values()
    ]
