"""Setpoints of one tick: at the samples' instants, and at both ends of the interval in which the coming force acts."""

from collections.abc import Sequence
from typing import Any, Final

from librt.vecs import vec
from mypy_extensions import i64

from hil.control.laws.base import LawInputs, Model
from hil.control.number import Number
from hil.control.trajectories import Trajectory

_NEVER: Final = -(1 << 60)  # ns


def nominal_net_force(force: Number, model: Model, mean_velocity: Number, mean_sign: Number) -> Number:
    """Applied force, less gravity hold and the nominal friction at the setpoint's mean velocity: the filter's known
    input, N.
    """
    wet = (abs(mean_velocity) * model.quadratic + model.viscous) * mean_velocity
    return force - model.coulomb * mean_sign - wet - model.gravity


class Setpoints:
    """Fills the reference fields of every axis' LawInputs (floats) from a trajectory, or from a held position when
    there is none.

    Instants are integer ns on the samples' clock, one per axis.
    """

    def __init__(self, inputs: Sequence[LawInputs], period_ns: int) -> None:
        self._inputs = list(inputs)
        self._period_ns = period_ns
        self._period = period_ns * 1e-9
        n = len(self._inputs)
        self.trajectory: Trajectory | None = None
        self.origin = [0] * n  # ns on the samples' clock at which the task's time is 0
        self._starts: vec[i64] = vec[i64]([_NEVER] * n)  # task times that `start` and `end` are filled for
        self._ends: vec[i64] = vec[i64]([_NEVER] * n)
        self.task_ns = -1  # first axis' sample instant on the task's clock; -1 where no task runs

    def hold(self, position: Sequence[float]) -> None:
        """From now on: at rest at `position`, m per axis."""
        self.trajectory = None
        self.task_ns = -1
        for x, q in zip(self._inputs, position, strict=True):
            x.task_ns = -1
            for reference in (x.sample, x.start, x.end):
                reference.position, reference.velocity, reference.acceleration = q, 0.0, 0.0
            for ahead in x.preview or ():  # not of the floats' Reference: a user's law makes them
                ahead.position, ahead.velocity, ahead.acceleration = q, 0.0, 0.0
            x.mean_velocity = x.mean_acceleration = x.mean_sign = 0.0

    def follow(self, trajectory: Trajectory, origin_ns: Sequence[int]) -> None:
        """From now on: `trajectory`, whose time 0 is at `origin_ns`."""
        self.trajectory = trajectory
        self.origin = list(origin_ns)
        for axis in range(len(self._inputs)):
            self._starts[axis] = self._ends[axis] = _NEVER

    def update(self, sample_ns: list[int], start_ns: list[int]) -> None:
        """Setpoints for samples taken at sample_ns and a force that acts from start_ns on."""
        trajectory = self.trajectory
        if trajectory is None:
            return
        for axis, origin in enumerate(self.origin):
            self._update_axis(trajectory, axis, sample_ns[axis] - origin, start_ns[axis] - origin)
        self.task_ns = sample_ns[0] - self.origin[0]

    def _update_axis(self, trajectory: Trajectory, axis: int, sampled: int, begins: int) -> None:
        """An interval mostly begins where the last one ended: the Reference objects are then swapped, not computed
        again.
        """
        x, period, ends = self._inputs[axis], self._period, begins + self._period_ns
        sample, start, end = x.sample, x.start, x.end
        if sampled == self._starts[axis]:
            sample, start = start, sample
        else:
            sample.position, sample.velocity, sample.acceleration = trajectory.at(axis, sampled)
        follows = begins == self._ends[axis]
        if follows:
            start, end = end, start
        else:
            start.position, start.velocity, start.acceleration = trajectory.at(axis, begins)
        if x.preview:
            self._look_ahead(trajectory, axis, begins, x.preview, follows=follows)
        self._starts[axis], self._ends[axis] = begins, ends
        end.position, end.velocity, end.acceleration = trajectory.at(axis, ends)
        x.sample, x.start, x.end, x.task_ns = sample, start, end, begins
        x.mean_velocity = (end.position - start.position) / period
        v0, v1 = start.velocity, end.velocity
        x.mean_acceleration = (v1 - v0) / period
        # The velocity taken as linear in the interval. The feedforward at the sample's instant instead would cost 45-55
        # um on the paper's task (docs/paper.md).
        total = abs(v0) + abs(v1)
        x.mean_sign = (v0 + v1) / total if total > 0.0 else 0.0

    def _look_ahead(self, trajectory: Trajectory, axis: int, begins: int, preview: list[Any], *, follows: bool) -> None:
        """References at `begins` and at the ends of the periods after it; only the last is new where the interval
        follows the one before.
        """
        first = len(preview) - 1 if follows else 0
        if follows:
            preview.append(preview.pop(0))
        for k in range(first, len(preview)):
            reference = preview[k]
            instant = begins + k * self._period_ns
            reference.position, reference.velocity, reference.acceleration = trajectory.at(axis, instant)
