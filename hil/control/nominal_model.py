"""The rig file's nominal model as the arrays that laws, estimator and batches work with."""

from functools import partial

import numpy as np

from hil.control.laws.base import LawInputs, Model, Reference
from hil.rig.schema import RigConfig


def rig_model(rig: RigConfig) -> Model:
    """The rig file's nominal model as arrays (n_axes,). The file's gravity acts on the axis; the model's holds against
    it.
    """
    axes = [axis.model for axis in rig.axes.values()]
    known = [axis.tolerances.known for axis in rig.axes.values()]
    none = [0.0, 0.0, 0.0]
    second, third = np.array([[*a.other_modes, none, none][:2] for a in axes]).transpose(1, 2, 0)
    return Model(
        mass=np.array([a.mass for a in axes]),
        coulomb=np.array([a.coulomb for a in axes]),
        viscous=np.array([a.viscous for a in axes]),
        quadratic=np.array([a.quadratic for a in axes]),
        gravity=np.array([-a.gravity for a in axes]) + 0.0,
        torque_lag=np.array([a.torque_lag for a in axes]),
        mode_frequency=np.array([a.mode_frequency_hz for a in axes]),
        mode_damping=np.array([a.mode_damping for a in axes]),
        mode_load=np.array([a.mode_load for a in axes]),
        presliding_least=np.array([min(a.presliding, default=0.0) for a in axes]),
        presliding_greatest=np.array([max(a.presliding, default=0.0) for a in axes]),
        known=np.array(known),
        second_frequency=second[0],
        second_damping=second[1],
        second_load=second[2],
        third_frequency=third[0],
        third_damping=third[1],
        third_load=third[2],
        friction_period=np.array([a.friction_period for a in axes]),
        travel=np.array([max(map(abs, axis.limits.position)) for axis in rig.axes.values()]),
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
