"""Many plants under one rig in one array: the cycle's own arithmetic without frames, faults and states.

A plant's error here equals that of `hil sim` on a rig file with the same [plant], bit for bit, unless a fault stops
the single run. Filter, setpoints, law, force limits, encoder rounding, the command's 32-bit force and the stage are
the same code, called in the same order. All plants share the task, the sampling instants and the start at rest. Where
brakes take time to open, a batch begins as they do.
"""

from collections.abc import Sequence

import numpy as np

from hil.control.estimator import behind_estimator
from hil.control.estimator.gains import design_gains, per_axis
from hil.control.estimator.motion_filter import MotionFilter
from hil.control.laws import make_law
from hil.control.laws.base import Array, Law, Reference, axis_inputs
from hil.control.laws.coupled import gather
from hil.control.nominal_model import rig_model
from hil.control.setpoints import Setpoints, nominal_net_force
from hil.control.trajectories import Trajectory, make_trajectory, task_repeat
from hil.cycle.gate import ForceLimits
from hil.cycle.limits import error_maps, force_limits
from hil.rig.schema import RigConfig
from sim_plant.physics.stage import Truth
from sim_plant.user_stage import stage_of

FIRST_ON_TASK = 2  # ticks after activation until a sample shows task time 0


def rig_law(rig: RigConfig, trajectory: Trajectory | None = None) -> Law:
    """The law the rig file names, with its gains, behind its estimator. trajectory: instead of the rig's task."""
    limit = np.array([axis.limits.force for axis in rig.axes.values()])
    repeat = None
    if rig.law.iterative_learning and trajectory is None:
        repeat = task_repeat(rig.task, rig.axis_names, rig.period_ns, rig.counts)
    elif rig.law.iterative_learning and trajectory is not None and trajectory.repeat_ns is not None:
        repeat = trajectory.repeat_ns, trajectory.repeat_from_ns
    model = rig_model(rig)
    law = make_law(rig.law, model, rig.period_ns * 1e-9, limit, repeat)
    return behind_estimator(law, rig, model, range(len(rig.axes)))


class Bounds:
    """hil.cycle.gate.limit_force for many plants at once; a test holds the two equal. Arrays (n_axes,)."""

    def __init__(self, limits: Sequence[ForceLimits]) -> None:
        self._force, self._low, self._high, self._step = (np.array(values) for values in zip(*limits, strict=True))

    def limit(self, request: Array, previous: Array, position: Array) -> Array:
        """Bounded force (plants, n_axes), N."""
        limited: Array = np.maximum(request, previous - self._step)
        np.minimum(limited, previous + self._step, out=limited)
        np.minimum(limited, self._force * (position < self._high), out=limited)
        np.maximum(limited, -self._force * (position > self._low), out=limited)
        return limited


def standing(rig: RigConfig, bounds: Bounds, weight: Array, position: Array) -> Array:
    """Force that the gate has let through as the law takes over, N: the weight's where brakes open on it, else none."""
    force = np.zeros(position.shape)
    for _ in range(rig.opening_ticks):
        force = bounds.limit(weight + 0.0 * force, force, position)
    return force


def sent(force: Array) -> Array:
    """As the command frame carries it, N."""
    return force.astype(np.float32).astype(np.float64)


class BatchRun:
    """Plants `truth` (plants, n_axes) under `rig`, from the tick in which the law takes over.

    trajectory: instead of the rig's task.

    error: true position less setpoint at the samples' instant of the latest tick (m). force: applied in it (N).
    Both (plants, n_axes); the next tick writes into the error's array.
    """

    def __init__(self, rig: RigConfig, truth: Truth, trajectory: Trajectory | None = None) -> None:
        n = len(rig.axes)
        shape = truth.shape
        self.rig = rig
        self.index = 0
        self._trajectory = trajectory
        self._period_ns = rig.period_ns
        self._model = rig_model(rig)
        gains, _ = design_gains(rig)
        self._filter = MotionFilter(list(gains), self._model.mass)
        self._bounds = Bounds(force_limits(rig))
        axes = rig.axes.values()
        self._law = rig_law(rig, trajectory)
        self._nominal_resolution = np.array([axis.encoder_resolution for axis in axes])
        self._resolution = per_axis(rig.plant.encoder_resolution, n)
        initial = per_axis(rig.plant.initial_position, n)
        self._stage = stage_of(rig.plant, truth, np.zeros(shape) + initial)
        self._maps = [(axis, one) for axis, one in enumerate(error_maps(rig)) if one is not None]
        self._origin = self._seen(initial)
        # What all plants have in common, on floats as in the cycle.
        self._shared = [axis_inputs() for _ in range(n)]
        for x in self._shared:
            x.fresh = 1.0
            x.sample_interval = x.ahead = self._period_ns * 1e-9
            if self._law.preview:
                x.preview = [Reference(0.0, 0.0, 0.0) for _ in range(self._law.preview + 1)]
        self._setpoints = Setpoints(self._shared, rig.period_ns)
        zero = np.zeros(shape)
        self._net_last, self._net_before = zero, zero
        self._measured, self.error = zero, np.zeros(shape)
        self.force = self._force_last = standing(rig, self._bounds, self._model.gravity, zero + self._origin)
        self._applied = sent(self.force)
        if rig.opening_ticks:
            self._stage.stand(self._applied)

    @property
    def law(self) -> Law:
        """The rig's law, of all plants."""
        return self._law

    def tick(self) -> None:
        """One control period of every plant."""
        now, n = self.index * self._period_ns, len(self.rig.axes)
        self._estimate()
        self._setpoints.update([now - self._period_ns] * n, [now] * n)
        if self.index == 0:
            self._engage()
        elif self.index == 1:
            rig = self.rig
            task = self._trajectory or make_trajectory(
                rig.task, rig.axis_names, self._origin, rig.period_ns, rig.counts
            )
            self._setpoints.follow(task, [now] * n)
            self._setpoints.update([now - self._period_ns] * n, [now] * n)
        self._act()
        if self.index:  # until the first command arrives the brakes hold the stage
            self._stage.advance(self._period_ns, self._applied)
        self._applied = sent(self.force)
        self.index += 1

    def change(self, truth: Truth) -> None:
        """From now on the plants are these."""
        self._stage.change(truth)

    def _estimate(self) -> None:
        motion, interval = self._filter, self._period_ns * 1e-9
        self._measured = self._seen(self._stage.read())
        motion.correct(self._net_before, interval, self._measured)
        motion.look_ahead(self._net_last, interval)

    def _seen(self, read: Array) -> Array:
        """What the cycle makes of the encoders, (…, n_axes), m."""
        seen: Array = np.rint(read / self._resolution) * self._nominal_resolution
        for axis, error_map in self._maps:
            seen[..., axis] = error_map.corrected_array(seen[..., axis])
        return seen

    def _engage(self) -> None:
        self._filter.reseed(self._measured)
        self._setpoints.hold(self._origin.tolist())
        self._law.reset(self._measured, self._model.gravity)

    def _act(self) -> None:
        inputs = gather(self._shared)
        inputs.position = self._measured
        self._filter.tell(inputs)
        inputs.force_before, inputs.force_last = self._force_last, self.force
        requested = self._law.force(inputs)
        np.subtract(self._stage.position, inputs.sample.position, out=self.error)
        self._force_last = self.force
        self.force = self._bounds.limit(requested, self.force, self._measured)
        self._net_before = self._net_last
        self._net_last = nominal_net_force(self.force, self._model, inputs.mean_velocity, inputs.mean_sign)
