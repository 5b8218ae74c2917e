"""Many plants under one rig in one array: the cycle's own arithmetic without frames, faults and states.

A plant's error here equals that of `hil sim` on a rig file with the same [plant], bit for bit, unless a fault stops
the single run: filter, setpoints, law, force limits, encoder rounding, the command's 32-bit force and the stage are the
same objects, called in the same order. All plants share the task, the sampling instants and the start at rest.
"""

import numpy as np

from hil.belief import blank_inputs, force_limits, rig_model
from hil.config import RigConfig
from hil.estimation import MotionFilter, design_gains, per_axis
from hil.gate import limit_force
from hil.laws import make_law
from hil.laws.base import Law
from hil.setpoints import Setpoints, nominal_net_force
from hil.trajectories import make_trajectory, task_repeat
from sim_plant.stage import Stage, Truth

FIRST_ON_TASK = 2  # ticks after activation until a sample shows task time 0


def rig_law(rig: RigConfig) -> Law:
    """The law the rig file names, with its gains."""
    limit = np.array([axis.limits.force for axis in rig.axes.values()])
    repeat = task_repeat(rig.task, rig.axis_names, rig.period_ns) if rig.law.iterative_learning else None
    return make_law(rig.law, rig_model(rig), rig.period_ns * 1e-9, limit, repeat)


class BatchRun:
    """Plants `truth` (plants, n_axes) under `rig`, from the tick in which the rig becomes ACTIVE.

    law: instead of the rig file's; its gains may differ from plant to plant, (plants, n_axes).

    error: true position less setpoint at the samples' instant of the latest tick (m). force: let out in it (N).
    Both (plants, n_axes), reused by the next tick.
    """

    def __init__(self, rig: RigConfig, truth: Truth, law: Law | None = None) -> None:
        n = len(rig.axes)
        shape = truth.shape
        self.rig = rig
        self.index = 0
        self._period_ns = rig.period_ns
        self._model = rig_model(rig)
        gains, variance = design_gains(rig)
        self._filter = MotionFilter(gains, variance, self._model.mass, shape)
        self._limits = force_limits(rig, shape)
        axes = rig.axes.values()
        self._law = law or rig_law(rig)
        self._belief = np.array([axis.encoder_resolution for axis in axes])
        self._resolution = per_axis(rig.plant.encoder_resolution, n)
        initial = per_axis(rig.plant.initial_position, n)
        self._stage = Stage(truth, np.zeros(shape) + initial)
        self._origin = np.rint(initial / self._resolution) * self._belief
        self._inputs = blank_inputs(shape)
        self._share_reference(n)
        self._setpoints = Setpoints(self._inputs, rig.period_ns)
        self._net_last, self._net_before = np.zeros(shape), np.zeros(shape)
        self._measured, self._scratch = np.zeros(shape), np.zeros(shape)
        self._friction = np.zeros(n)
        self._previous, self._applied = np.zeros(shape), np.zeros(shape)
        self.force, self.error = np.zeros(shape), np.zeros(shape)

    def _share_reference(self, n: int) -> None:
        """What all plants have in common is kept once: (n_axes,), broadcast by the law."""
        inputs = self._inputs
        inputs.fresh = np.ones(n)
        inputs.sample_interval = np.full(n, self._period_ns * 1e-9)
        inputs.ahead = np.full(n, self._period_ns * 1e-9)
        inputs.mean_velocity, inputs.mean_acceleration, inputs.mean_sign = np.zeros(n), np.zeros(n), np.zeros(n)

    def tick(self) -> None:
        """One control period of every plant."""
        now, n = self.index * self._period_ns, len(self.rig.axes)
        self._estimate()
        self._setpoints.update([now - self._period_ns] * n, [now] * n)
        if self.index == 0:
            self._engage()
        elif self.index == 1:
            rig = self.rig
            self._setpoints.follow(make_trajectory(rig.task, rig.axis_names, self._origin, rig.period_ns), [now] * n)
            self._setpoints.update([now - self._period_ns] * n, [now] * n)
        self._act()
        np.subtract(self._stage.position, self._inputs.sample.position, out=self.error)
        if self.index:  # until the first command arrives the brakes hold the stage
            self._stage.advance(self._period_ns, self._applied)
        self._applied[...] = self.force.astype(np.float32)
        self.index += 1

    def _estimate(self) -> None:
        inputs, motion = self._inputs, self._filter
        np.divide(self._stage.position, self._resolution, out=self._measured)
        np.rint(self._measured, out=self._measured)
        np.multiply(self._measured, self._belief, out=self._measured)
        inputs.position = self._measured
        motion.predict(self._net_before, inputs.sample_interval)
        motion.innovate(self._measured)
        motion.update(None)
        motion.look_ahead(self._net_last, inputs.ahead)
        inputs.position_estimate = motion.ahead_position
        inputs.velocity_estimate = motion.ahead_velocity
        inputs.disturbance_estimate = motion.disturbance

    def _engage(self) -> None:
        self._filter.reseed(self._measured)
        self._setpoints.hold(self._origin)
        self._law.reset(self._measured.copy(), self._model.gravity)

    def _act(self) -> None:
        inputs = self._inputs
        inputs.force_before, inputs.force_last = inputs.force_last, inputs.force_before
        inputs.force_last[...] = self.force
        requested = self._law.force(inputs)
        self._previous[...] = self.force
        limit_force(requested, self._previous, self._measured, self._limits, self.force, self._scratch)
        self._net_before, self._net_last = self._net_last, self._net_before
        nominal_net_force(
            self.force, self._model, inputs.mean_velocity, inputs.mean_sign, self._net_last, self._friction
        )
