"""A rig's axes as the control cycle sees them: law inputs, motion filters, setpoints and the law, all on floats.

The stages of a tick write here in turn, each for the next (docs: the fields of hil.control.laws.base.LawInputs):
sampling fills `fresh`, `position` and the intervals; the motion filters the estimates; the setpoints the references;
the gate's outcome `force_last` and `force_before`. `measured` is the list of newest positions, m. `net_last` and
`net_before` are the filters' known input, N: the force applied in the latest tick and in the one before it, less what
the nominal model says friction and gravity take of it.
"""

from collections.abc import Sequence

import numpy as np

from hil.control.estimator.gains import design_gains
from hil.control.estimator.motion_filter import MotionFilter, VelocityBlend
from hil.control.laws import make_axis_laws
from hil.control.laws.base import AxisLaws, axis_inputs, axis_model
from hil.control.nominal_model import rig_model
from hil.control.setpoints import Setpoints, nominal_net_force
from hil.control.trajectories import task_repeat
from hil.rig.schema import RigConfig


class Axes:
    """One object per axis of each kind. Raises ValueError naming the law or filter that this rig cannot have."""

    def __init__(self, rig: RigConfig) -> None:
        n, axes = len(rig.axes), list(rig.axes.values())
        model = rig_model(rig)
        self.models = [axis_model(model, index) for index in range(n)]
        gains, variance = design_gains(rig)
        self.filters = [MotionFilter(gains[:, i].tolist(), self.models[i].mass) for i in range(n)]
        self.shown = [VelocityBlend(0.0, rig.period_ns * 1e-9) for _ in range(n)]  # for people
        self.innovation_limit: list[float] = np.sqrt(variance * rig.safety.nis_limit).tolist()  # m
        learning = rig.law.iterative_learning
        repeat = task_repeat(rig.task, rig.axis_names, rig.period_ns, rig.counts) if learning else None
        force = np.array([axis.limits.force for axis in axes])
        self.law: AxisLaws = make_axis_laws(rig.law, model, rig.period_ns * 1e-9, force, repeat)
        if rig.estimator.is_users:
            from hil.control.estimator.users import EstimatedAxes  # few rigs have one

            self.law = EstimatedAxes(self.law, rig, model)
        self.inputs = [axis_inputs() for _ in range(n)]
        self.setpoints = Setpoints(self.inputs, rig.period_ns)
        self.zero = [0.0] * n
        self.measured = self.net_last = self.net_before = self.zero

    def rest(self) -> None:
        """At rest where the axes are: filters, setpoints and law know nothing of earlier runs."""
        for x, motion in zip(self.inputs, self.filters, strict=True):
            motion.reseed(x.position)
            motion.tell(x)
        self.net_last = self.net_before = self.zero
        self.setpoints.hold(self.measured)
        self.law.reset(self.measured, [model.gravity for model in self.models])

    def hold(self) -> None:
        """No task runs any more. Else its setpoints would go on, and the filters expect the friction of that motion."""
        self.setpoints.hold(self.measured)

    def ahead_velocity(self) -> list[float]:
        """Estimated velocity where the next force begins to act, m/s per axis."""
        return [motion.ahead_velocity for motion in self.filters]

    def note_applied(self, force: Sequence[float]) -> None:
        """The force just applied, N per axis; it acts in the interval that the setpoints' mean values belong to."""
        self.net_before = self.net_last
        models = self.models
        self.net_last = [
            nominal_net_force(force[axis], models[axis], x.mean_velocity, x.mean_sign)
            for axis, x in enumerate(self.inputs)
        ]
