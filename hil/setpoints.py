"""Setpoints of one tick: at the samples' instants, and at both ends of the interval in which the coming force acts."""

from collections.abc import Sequence

from hil.laws.base import LawInputs, Model, Reference
from hil.number import Number
from hil.trajectories import Trajectory


def average_reference(inputs: LawInputs, period: float) -> None:
    """Means over [start, end] of velocity, acceleration and sgn(velocity), of one axis (floats).

    The sign's mean takes the velocity as linear in the interval: (v0 + v1) / (|v0| + |v1|), 0 at rest. Evaluating the
    feedforward at the sample's instant instead costs 45-55 um on the paper's task (PAPER.md, Pitfalls).
    """
    start, end = inputs.start, inputs.end
    v0, v1 = start.velocity, end.velocity
    inputs.mean_velocity = (end.position - start.position) / period
    inputs.mean_acceleration = (v1 - v0) / period
    total = abs(v0) + abs(v1)
    inputs.mean_sign = (v0 + v1) / total if total > 0.0 else 0.0


def nominal_net_force(force: Number, model: Model, mean_velocity: Number, mean_sign: Number) -> Number:
    """Force let out, less gravity hold and the nominal friction at the setpoint's mean velocity: the filter's known
    input, N.
    """
    wet = (abs(mean_velocity) * model.quadratic + model.viscous) * mean_velocity
    return force - model.coulomb * mean_sign - wet - model.gravity


def _fill(reference: Reference, values: tuple[float, float, float]) -> None:
    reference.position, reference.velocity, reference.acceleration = values


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
        self._starts: list[int | None] = [None] * n  # task times that `start` and `end` are filled for
        self._ends: list[int | None] = [None] * n
        self.task_ns = -1  # first axis' sample instant on the task's clock; -1 where no task runs

    def hold(self, position: Sequence[float]) -> None:
        """From now on: at rest at `position`, m per axis."""
        self.trajectory = None
        self.task_ns = -1
        for x, q in zip(self._inputs, position, strict=True):
            x.task_ns = -1
            for reference in (x.sample, x.start, x.end):
                _fill(reference, (q, 0.0, 0.0))
            x.mean_velocity = x.mean_acceleration = x.mean_sign = 0.0

    def follow(self, trajectory: Trajectory, origin_ns: Sequence[int]) -> None:
        """From now on: `trajectory`, whose time 0 is at `origin_ns`."""
        self.trajectory = trajectory
        self.origin = list(origin_ns)
        self._starts = [None] * len(self._inputs)
        self._ends = [None] * len(self._inputs)

    def update(self, sample_ns: Sequence[int], start_ns: Sequence[int]) -> None:
        """Setpoints for samples taken at sample_ns and a force that acts from start_ns on."""
        if self.trajectory is None:
            return
        for axis, origin in enumerate(self.origin):
            self._update_axis(axis, sample_ns[axis] - origin, start_ns[axis] - origin)
        self.task_ns = sample_ns[0] - self.origin[0]

    def _update_axis(self, axis: int, sampled: int, begins: int) -> None:
        """An interval mostly begins where the last one ended: then the objects change places and keep their values."""
        x, at = self._inputs[axis], self.trajectory.at  # type: ignore[union-attr]
        if sampled == self._starts[axis]:
            x.sample, x.start = x.start, x.sample
        else:
            _fill(x.sample, at(axis, sampled))
        if begins == self._ends[axis]:
            x.start, x.end = x.end, x.start
        else:
            _fill(x.start, at(axis, begins))
        ends = begins + self._period_ns
        _fill(x.end, at(axis, ends))
        self._starts[axis], self._ends[axis] = begins, ends
        x.task_ns = begins
        average_reference(x, self._period)
