"""Estimators that users bring: ordinary Python classes, run interpreted in every build, and trusted with nothing.

They stand between the rig's filter and its law: the law is asked behind them, and sees their position and velocity in
place of the filter's. One that raises, returns no two finite numbers, or does not return counts no more. In its place
NaN is asked for, which the cycle answers with zero torque and a fault, as it does to a law that fails. `failure` says
which line of which file it was. The next `reset` gives it another chance.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from drivers.base import plugins
from drivers.base.guard import Guard, next_call
from hil.control.estimator.contract import Estimator, Measurement
from hil.control.laws.base import Array, AxisLaws, Law, LawInputs, Model, axis_model
from hil.control.number import Number, copy
from hil.control.setpoints import nominal_net_force
from hil.rig.schema import RigConfig
from hil.rig.tables import ESTIMATOR_KIND

Update = Callable[[Measurement], tuple[float, float]]


class _Maker:
    """The class that [estimator] names, and what is said of it. Raises ValueError."""

    def __init__(self, rig: RigConfig) -> None:
        self._config, self._period = rig.estimator, rig.period_ns * 1e-9
        self._resolutions = [axis.encoder_resolution for axis in rig.axes.values()]
        self._made = plugins.find(ESTIMATOR_KIND, self._config.name, self._config.source)
        plugins.check_parameters(ESTIMATOR_KIND, self._config.name, self._made, self._config.parameters, given=3)
        self._guard = Guard(ESTIMATOR_KIND, self._config.name, self._made)
        self.limited = self._guard.limited

    def make(self, axis: int, model: Model) -> Estimator:
        """A new one for an axis of the rig; model: of floats."""
        own = self._config.parameters_of(axis)
        made: Estimator = self._guard.call(
            "it cannot be made", self._made, model, self._period, self._resolutions[axis], **own
        )
        return made


class _Watched:
    """What is measured of one axis (floats) or many (arrays), with what the nominal model makes of the forces."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self.reset()

    def reset(self) -> None:
        """At rest: whatever force acts there, something holds against it."""
        self._moving: tuple[Number, Number] | None = None  # mean velocity and sign while the last force acts
        self._net: Number = 0.0
        self._age: Number = 0.0

    def measured(self, x: LawInputs) -> Measurement:
        """This tick's."""
        net = self._net
        self._net = 0.0 if self._moving is None else nominal_net_force(x.force_last, self._model, *self._moving)
        self._moving = copy(x.mean_velocity), copy(x.mean_sign)
        self._age = (self._age + x.sample_interval) * (1.0 - x.fresh)
        return Measurement(
            x.position, x.fresh, self._age, x.sample_interval, x.ahead, x.force_before, x.force_last, net, self._net,
            x.position_estimate, x.velocity_estimate,
        )  # fmt: skip


class EstimatedAxes:
    """AxisLaws (laws/base.py) of a rig's law behind its users' estimators, one an axis. model: arrays (n_axes,).

    law: behind the estimators. laws: those of the law, where it has one an axis. Raises ValueError naming the key.
    """

    def __init__(self, law: AxisLaws, rig: RigConfig, model: Any) -> None:
        self.law, maker = law, _Maker(rig)
        self._limited = maker.limited("update", self._fail)
        models = [axis_model(model, axis) for axis in range(len(rig.axes))]
        self._estimators = [maker.make(axis, own) for axis, own in enumerate(models)]
        self._updates: list[Update] = [estimator.update for estimator in self._estimators]
        self._watched = [_Watched(own) for own in models]
        self._failure = ""

    @property
    def laws(self) -> Sequence[Law]:
        """See PerAxis."""
        return getattr(self.law, "laws", ())

    @property
    def failure(self) -> str:
        """Why the estimator no longer counts, or else the law."""
        return self._failure or self.law.failure

    @property
    def denominator_floors(self) -> int:
        """See AxisLaws."""
        return self.law.denominator_floors

    def reset(self, position: Sequence[float], force: Sequence[float]) -> None:
        """See AxisLaws."""
        self._failure = ""
        for watched in self._watched:
            watched.reset()
        with self._limited:
            for estimator, q in zip(self._estimators, position, strict=True):
                estimator.reset(q)
        self.law.reset(position, force)

    def _fail(self, why: str) -> None:
        self._failure = why

    def force(self, axes: Sequence[Any]) -> list[float]:
        """See AxisLaws; NaN for all axes where an estimator has failed. The estimates of `axes` are replaced."""
        if not self._failure:
            self._estimate(axes)
        return [math.nan] * len(axes) if self._failure else self.law.force(axes)

    def _estimate(self, axes: Sequence[Any]) -> None:
        with self._limited:
            for x, watched, update in zip(axes, self._watched, self._updates, strict=True):
                position, velocity = _numbers(update(watched.measured(x)))
                if position - position != 0.0 or velocity - velocity != 0.0:
                    raise ValueError(f"update returned {position}, {velocity}")
                x.position_estimate, x.velocity_estimate = position, velocity


class EstimatedLaw(Law):
    """A law on arrays (..., axes) behind users' estimators: one object for every axis of every stage.

    Whatever one raises, or returns that is no pair of numbers, is a ValueError that names the file and the line. A
    stage that has diverged has no estimate.
    """

    def __init__(self, law: Law, rig: RigConfig, model: Model, axes: Sequence[int]) -> None:
        self._law, self._axes, self._maker = law, axes, _Maker(rig)
        self._limited = self._maker.limited("update")
        self._models = [axis_model(model, index) for index in range(len(axes))]
        self._watched = _Watched(model)
        self._shape: tuple[int, ...] = ()
        self._updates: list[Update] = []
        self.coupled, self.preview = law.coupled, law.preview
        for axis, own in zip(axes, self._models, strict=True):
            self._maker.make(axis, own)  # whether it can be, before anything runs

    def reset(self, position: Array, force: Array) -> None:
        """See Law."""
        self._shape = np.shape(position)
        self._watched.reset()
        estimators = [
            self._maker.make(self._axes[place[-1]], self._models[place[-1]]) for place in np.ndindex(self._shape)
        ]
        self._updates = [estimator.update for estimator in estimators]
        with self._limited:
            for estimator, q in zip(estimators, np.ravel(position).tolist(), strict=True):
                next_call()
                estimator.reset(q)
        self._law.reset(position, force)

    def force(self, inputs: LawInputs) -> Array:
        """See Law. The estimates of `inputs` are replaced."""
        columns = [np.broadcast_to(values, self._shape).ravel().tolist() for values in self._watched.measured(inputs)]
        with self._limited:
            found = [self._estimate(*each) for each in zip(self._updates, *columns, strict=True)]
        position, velocity = np.array(found).reshape(*self._shape, 2).transpose(-1, *range(len(self._shape)))
        inputs.position_estimate, inputs.velocity_estimate = position.copy(), velocity.copy()
        asked: Array = self._law.force(inputs)
        return asked

    @staticmethod
    def _estimate(update: Update, *values: float) -> tuple[float, float]:
        next_call()
        measurement = Measurement(*values)
        return _numbers(update(measurement)) if math.isfinite(measurement.position) else (math.nan, math.nan)


def _numbers(answer: Any) -> tuple[float, float]:
    """An estimator's answer as two floats. Raises TypeError where it is none."""
    try:
        position, velocity = answer
        if type(position) is float and type(velocity) is float:
            return position, velocity
        if any(isinstance(value, bool | str | bytes) or np.ndim(value) for value in (position, velocity)):
            raise TypeError
        return float(position), float(velocity)
    except (TypeError, ValueError):
        raise TypeError(f"update returned {answer!r:.60}, expected a position and a velocity") from None
