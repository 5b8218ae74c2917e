"""A rig's axes as the control cycle sees them: law inputs, motion filters, setpoints and the law, all on floats.

The stages of a tick write here in turn, each for the next (docs: the fields of hil.control.laws.base.LawInputs).
Sampling fills `fresh`, `position` and the intervals; the motion filters the estimates; the setpoints the references;
the gate's outcome `force_last` and `force_before`. `measured` is the list of newest positions, m. `net_last` and
`net_before` are the filters' known input, N: the force applied in the latest tick and in the one before it, less what
the nominal model says friction and gravity take of it.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hil.control.estimator.gains import design_gains
from hil.control.estimator.motion_filter import MotionFilter, VelocityBlend
from hil.control.laws import AxisLawMaker, make_axis_laws
from hil.control.laws.base import AxisLaws, Law, axis_inputs, axis_model
from hil.control.laws.handover import Handover
from hil.control.nominal_model import rig_model
from hil.control.setpoints import Setpoints, nominal_net_force
from hil.control.trajectories import task_repeat
from hil.cycle.tick import LoadedLaw
from hil.rig.schema import RigConfig


class Axes:
    """One object per axis of each kind. Raises ValueError naming the law or filter that this rig cannot have."""

    def __init__(self, rig: RigConfig) -> None:
        n, axes = len(rig.axes), list(rig.axes.values())
        self._model = model = rig_model(rig)
        self.models = [axis_model(model, index) for index in range(n)]
        gains, variance = design_gains(rig)
        self.filters = [MotionFilter(gains[:, i].tolist(), self.models[i].mass) for i in range(n)]
        self.shown = [VelocityBlend(0.0, rig.period_ns * 1e-9) for _ in range(n)]  # for people
        self.innovation_limit: list[float] = np.sqrt(variance * rig.safety.nis_limit).tolist()  # m
        learning = rig.law.iterative_learning
        repeat = task_repeat(rig.task, rig.axis_names, rig.period_ns, rig.counts) if learning else None
        self._period_s, self._limit = rig.period_ns * 1e-9, np.array([axis.limits.force for axis in axes])
        self.law: AxisLaws = make_axis_laws(rig.law, model, self._period_s, self._limit, repeat)
        self._trusted = True  # no fault since the last rest: what was learnt is worth keeping
        self._estimated: Any = None
        if rig.estimator.is_users:
            from hil.control.estimator.users import EstimatedAxes  # few rigs have one

            self._estimated = self.law = EstimatedAxes(self.law, rig, model)
        self._keeping: Sequence[Law] = getattr(self.law, "laws", ()) if rig.law.keeps else ()
        self._asked: LoadedLaw | None = None
        self._maker: AxisLawMaker | None = None
        self.inputs = [axis_inputs() for _ in range(n)]
        self.setpoints = Setpoints(self.inputs, rig.period_ns)
        self.zero = [0.0] * n
        self.measured = self.net_last = self.net_before = self.zero

    def make_law(self, asked: LoadedLaw) -> bool:
        """A piece of making a law: one axis. Returns whether it is made. Raises ValueError as make_axis_laws."""
        if self._asked is not asked or self._maker is None:
            self._asked = asked
            self._maker = AxisLawMaker(asked.law, self._model, self._period_s, self._limit, None, asked.designed)
            return False
        return self._maker.work()

    def take_law(self, asked: LoadedLaw) -> bool:
        """From now on that law, without a step of the force. What `make_law` has made of it need not be made again.
        Returns True.
        """
        while not self.make_law(asked):
            pass
        assert self._maker is not None
        law = self._maker.made()
        self._asked = self._maker = None
        if self._estimated is not None:
            self._estimated.law = Handover(self._estimated.law, law, self._period_s)
        else:
            self.law = Handover(self.law, law, self._period_s)
        return True

    def rest(self) -> None:
        """At rest where the axes are: filters and setpoints know nothing of earlier runs, the law what it keeps."""
        self.keep()
        self._trusted = True
        for x, motion in zip(self.inputs, self.filters, strict=True):
            motion.reseed(x.position)
            motion.tell(x)
        self.net_last = self.net_before = self.zero
        self.setpoints.hold(self.measured)
        self.law.reset(self.measured, self.weights())

    def weights(self) -> list[float]:
        """What holds the axes against gravity, N per axis."""
        return [model.gravity for model in self.models]

    def distrust(self) -> None:
        """A fault latches: what the law has learnt since the last rest is not kept."""
        self._trusted = False

    def keep(self) -> None:
        """What the law has learnt since the last rest begins the next run, where this rig keeps it."""
        if self._trusted:
            for law in self._keeping:
                law.keep()

    def kept(self) -> list[list[float]]:
        """By axis, what the next run begins with; empty lists: nothing."""
        return [[float(value) for value in law.kept()] for law in self._keeping]

    def move_origin(self, axis: int, by: float) -> None:
        """The axis rests where it is, and that place is `by` m further on from now on."""
        x, motion = self.inputs[axis], self.filters[axis]
        x.position += by
        self.measured = [each.position for each in self.inputs]
        motion.reseed(x.position)
        motion.tell(x)
        self.shown[axis].reseed(x.position)

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
