"""Setpoints of one tick: at the samples' instants, and at both ends of the interval in which the coming force acts."""

import numpy as np
from numpy.typing import NDArray

from hil.laws.base import Array, LawInputs, Model, Reference
from hil.trajectories import Trajectory

Times = NDArray[np.int64]
SAMPLE, START, END = 0, 1, 2


def average_reference(
    start: Reference, end: Reference, period: float, velocity: Array, acceleration: Array, sign: Array, scratch: Array
) -> None:
    """Means over [start, end] of velocity, acceleration and sgn(velocity), into the last three arrays before scratch.

    The sign's mean takes the velocity as linear in the interval: (v0 + v1) / (|v0| + |v1|), 0 at rest. Evaluating the feedforward at the
    sample's instant instead costs 45-55 um on the paper's task (PAPER.md, Pitfalls).
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


def nominal_net_force(force: Array, model: Model, mean_velocity: Array, mean_sign: Array, out: Array, scratch: Array) -> None:
    """Force let out, less gravity hold and the nominal friction at the setpoint's mean velocity: the filter's known input, N."""
    np.multiply(model.coulomb, mean_sign, out=scratch)
    np.subtract(force, scratch, out=out)
    np.abs(mean_velocity, out=scratch)
    np.multiply(scratch, model.quadratic, out=scratch)
    np.add(scratch, model.viscous, out=scratch)
    np.multiply(scratch, mean_velocity, out=scratch)
    np.subtract(out, scratch, out=out)
    np.subtract(out, model.gravity, out=out)


class Setpoints:
    """Fills a LawInputs' reference fields from a trajectory, or from a held position when there is none."""

    def __init__(self, inputs: LawInputs, period_ns: int) -> None:
        self._inputs = inputs
        self._period_ns = period_ns
        self._period = period_ns * 1e-9
        n = inputs.position.shape[-1]
        self._times: Times = np.zeros((3, n), dtype=np.int64)
        self._scratch: Array = np.zeros(n)
        self._zero: Array = np.zeros(n)
        self.trajectory: Trajectory | None = None
        self._origin: Times = np.zeros(n, dtype=np.int64)

    def hold(self, position: Array) -> None:
        """From now on: at rest at `position` (n_axes,), m."""
        self.trajectory = None
        inputs, zero = self._inputs, self._zero
        held = Reference(position.copy(), zero, zero)
        inputs.sample = inputs.start = inputs.end = held
        for mean in (inputs.mean_velocity, inputs.mean_acceleration, inputs.mean_sign):
            mean[...] = 0.0

    def follow(self, trajectory: Trajectory, origin_ns: Times) -> None:
        """From now on: `trajectory`, whose time 0 is at `origin_ns` per axis on the samples' clock."""
        self.trajectory = trajectory
        self._origin[...] = origin_ns

    def update(self, sample_ns: Times, start_ns: Times) -> None:
        """Setpoints for samples taken at sample_ns and a force that acts from start_ns on, both (n_axes,)."""
        if self.trajectory is None:
            return
        times, inputs = self._times, self._inputs
        np.subtract(sample_ns, self._origin, out=times[SAMPLE])
        np.subtract(start_ns, self._origin, out=times[START])
        np.add(times[START], self._period_ns, out=times[END])
        reference = self.trajectory.sample(times)
        position, velocity, acceleration = reference.position, reference.velocity, reference.acceleration
        inputs.sample = Reference(position[SAMPLE], velocity[SAMPLE], acceleration[SAMPLE])
        inputs.start = Reference(position[START], velocity[START], acceleration[START])
        inputs.end = Reference(position[END], velocity[END], acceleration[END])
        average_reference(
            inputs.start, inputs.end, self._period, inputs.mean_velocity, inputs.mean_acceleration, inputs.mean_sign, self._scratch
        )

    @property
    def task_ns(self) -> int:
        """First axis' sample instant on the task's clock; -1 where no task runs."""
        return int(self._times[SAMPLE, 0]) if self.trajectory is not None else -1
