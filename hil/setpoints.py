"""Setpoints of one tick: at the samples' instants, and at both ends of the interval in which the coming force acts."""

from collections.abc import Sequence

import numpy as np

from hil.laws.base import Array, LawInputs, Model, Reference
from hil.trajectories import Trajectory


def average_reference(
    start: Reference, end: Reference, period: float, velocity: Array, acceleration: Array, sign: Array, scratch: Array
) -> None:
    """Means over [start, end] of velocity, acceleration and sgn(velocity), into the last three arrays before scratch.

    The sign's mean takes the velocity as linear in the interval: (v0 + v1) / (|v0| + |v1|), 0 at rest. Evaluating the
    feedforward at the sample's instant instead costs 45-55 um on the paper's task (PAPER.md, Pitfalls).
    """
    np.subtract(end.position, start.position, out=velocity)
    np.divide(velocity, period, out=velocity)
    np.subtract(end.velocity, start.velocity, out=acceleration)
    np.divide(acceleration, period, out=acceleration)
    np.abs(start.velocity, out=scratch)
    np.abs(end.velocity, out=sign)
    np.add(scratch, sign, out=scratch)
    np.maximum(scratch, 1e-300, out=scratch)
    np.add(start.velocity, end.velocity, out=sign)
    np.divide(sign, scratch, out=sign)


def nominal_net_force(
    force: Array, model: Model, mean_velocity: Array, mean_sign: Array, out: Array, scratch: Array
) -> None:
    """Force let out, less gravity hold and the nominal friction at the setpoint's mean velocity: the filter's known
    input, N.
    """
    np.multiply(model.coulomb, mean_sign, out=scratch)
    np.subtract(force, scratch, out=out)
    np.abs(mean_velocity, out=scratch)
    np.multiply(scratch, model.quadratic, out=scratch)
    np.add(scratch, model.viscous, out=scratch)
    np.multiply(scratch, mean_velocity, out=scratch)
    np.subtract(out, scratch, out=out)
    np.subtract(out, model.gravity, out=out)


class Setpoints:
    """Fills a LawInputs' reference fields from a trajectory, or from a held position when there is none.

    Instants are integer ns on the samples' clock, one per axis.
    """

    def __init__(self, inputs: LawInputs, period_ns: int) -> None:
        self._inputs = inputs
        self._period_ns = period_ns
        self._period = period_ns * 1e-9
        n = inputs.position.shape[-1]
        self._scratch: Array = np.zeros(n)
        self._zero: Array = np.zeros(n)
        self.trajectory: Trajectory | None = None
        self._origin = [0] * n
        self._sample: tuple[int, ...] = (0,) * n

    def hold(self, position: Array) -> None:
        """From now on: at rest at `position` (n_axes,), m."""
        self.trajectory = None
        self._inputs.task_ns = -1
        inputs, zero = self._inputs, self._zero
        held = Reference(position.copy(), zero, zero)
        inputs.sample = inputs.start = inputs.end = held
        for mean in (inputs.mean_velocity, inputs.mean_acceleration, inputs.mean_sign):
            mean[...] = 0.0

    def follow(self, trajectory: Trajectory, origin_ns: Sequence[int]) -> None:
        """From now on: `trajectory`, whose time 0 is at `origin_ns`."""
        self.trajectory = trajectory
        self._origin = list(origin_ns)

    def update(self, sample_ns: Sequence[int], start_ns: Sequence[int]) -> None:
        """Setpoints for samples taken at sample_ns and a force that acts from start_ns on."""
        trajectory = self.trajectory
        if trajectory is None:
            return
        inputs, origin, period = self._inputs, self._origin, self._period_ns
        self._sample = tuple([t - zero for t, zero in zip(sample_ns, origin, strict=True)])
        start = tuple([t - zero for t, zero in zip(start_ns, origin, strict=True)])
        inputs.sample = trajectory.at(self._sample)
        inputs.start = trajectory.at(start)
        inputs.end = trajectory.at(tuple([t + period for t in start]))
        inputs.task_ns = start[0]
        average_reference(
            inputs.start,
            inputs.end,
            self._period,
            inputs.mean_velocity,
            inputs.mean_acceleration,
            inputs.mean_sign,
            self._scratch,
        )

    @property
    def task_ns(self) -> int:
        """First axis' sample instant on the task's clock; -1 where no task runs."""
        return self._sample[0] if self.trajectory is not None else -1
