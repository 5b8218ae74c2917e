"""A step of every effect of a real stage ([plant] stage other than ideal), on all axes at once.

What a stage may do without notice must not stop the rig; what can make a loop ring may, by a fault that says so. Sizes
are in what the axis has: mass, Coulomb friction and encoder counts.
"""

from collections.abc import Callable

from hil.cycle.fault_table import Fault
from hil.rig.tables import AxisConfig
from hil.studies.fault_campaign.checkpoints import CampaignRun
from hil.studies.fault_campaign.trial import BY_MOTION, Step, Trial

_WATCHED = 150  # ticks: an oscillation takes that long to grow and to be told
Size = Callable[[AxisConfig], float]


def _all_axes(key: str, size: Size) -> Step:
    """That key of every axis' truth (sim_plant.physics.truth.Truth.changed) steps to `size` of the axis."""

    def step(run: CampaignRun, axis: int, k: int) -> None:
        if k == 0:
            for number, config in enumerate(run.rig.axes.values()):
                run.stage.change_plant(number, key, size(config))

    return step


def _borne(key: str, size: Size) -> Trial:
    """What every law has to bear."""
    return Trial(f"plant steps: {key}", _all_axes(key, size), per_axis=False, benign=True, watch=_WATCHED, staged=True)


def _may_ring(key: str, size: Size) -> Trial:
    """What takes margin from the loop: it may end in a fault, if in one of motion."""
    faults: tuple[Fault, ...] = BY_MOTION
    return Trial(
        f"plant steps: {key}",
        _all_axes(key, size),
        faults,
        per_axis=False,
        certain=False,
        watch=_WATCHED,
        staged=True,
    )


def _of_friction(factor: float) -> Size:
    return lambda axis: factor * axis.model.coulomb


def _of_count(factor: float) -> Size:
    return lambda axis: factor * axis.encoder_resolution


def _always(value: float) -> Size:
    return lambda axis: value


PLANT_STEPS = (
    _borne("bias", _of_friction(0.3)),
    _borne("bias_walk", _of_friction(0.3)),
    _borne("torque_noise", lambda axis: 1e-3 * axis.model.mass),
    _borne("cogging", _of_friction(0.2)),
    _borne("friction_variation", _always(0.4)),
    _borne("cable_stiffness", _of_friction(5.0)),
    _borne("cable_hysteresis", _of_friction(0.2)),
    _borne("vibration", lambda axis: 0.05 * axis.model.coulomb / axis.model.mass),
    _borne("backlash", _of_count(1000.0)),
    _borne("drift", _always(1e-6)),
    _borne("encoder_noise", _of_count(2.0)),
    _borne("encoder_periodic_error", _of_count(20.0)),
    _may_ring("presliding", _always(1e-6)),
    _may_ring("torque_lag", _always(1e-3)),
    _may_ring("mode_frequency", _always(140.0)),
    _may_ring("mode_load", _always(0.5)),
    _may_ring("encoder_latency", _always(5e-4)),
)
