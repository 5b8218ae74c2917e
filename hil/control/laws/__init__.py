"""Control laws by name, one per file, all with the signature of hil/control/laws/base.py; see `LAWS` and `make_law`."""

import sys
from typing import Any

import numpy as np

from drivers.toml_file import shown
from hil.control.laws.base import Array, AxisLaws, Law, Model, axis_model
from hil.control.laws.computed_torque import ComputedTorque
from hil.control.laws.coupled import Coupled
from hil.control.laws.disturbance_observer import DisturbanceObserver
from hil.control.laws.iterative_learning import LEARNING_GAINS, IterativeLearning
from hil.control.laws.pd_feedforward import PdFeedforward
from hil.control.laws.per_axis import PerAxis
from hil.control.laws.pid import Pid
from hil.control.laws.presliding_kalman import PreslidingKalman
from hil.control.laws.robust_pd import AlphaBracketsPd, FilteredErrorPd, RobustPd
from hil.control.laws.sliding_mode import SlidingMode
from hil.control.laws.slotine_li import SlotineLi
from hil.control.laws.structured_kalman import StructuredKalman
from hil.control.laws.super_twisting import SuperTwisting
from hil.control.number import Number
from hil.rig.schema import LawConfig

__all__ = ["LAWS", "make_axis_laws", "make_law"]

LAWS: dict[str, type[Law]] = {
    law.name: law
    for law in (
        PdFeedforward,
        RobustPd,
        FilteredErrorPd,
        AlphaBracketsPd,
        Pid,
        ComputedTorque,
        SlidingMode,
        SlotineLi,
        SuperTwisting,
        DisturbanceObserver,
        StructuredKalman,
        PreslidingKalman,
    )
}


def _gain(key: str, value: Any, n_axes: int, default: Any) -> Any:
    """One gain as the law takes it: a word stays, a number or one per axis becomes (n_axes,). Raises ValueError."""
    if isinstance(default, str):
        if not isinstance(value, str):
            raise ValueError(f"law.gains.{key} = {shown(value)}: expected a word such as {default!r}")
        return value
    values = value if isinstance(value, list | tuple | np.ndarray) else [value] * n_axes
    if len(values) != n_axes:
        raise ValueError(f"law.gains.{key} has {len(values)} values for {n_axes} axes")
    for item in values:
        is_number = isinstance(item, int | float) and not isinstance(item, bool)
        if not is_number or not 0 <= item <= sys.float_info.max:
            raise ValueError(f"law.gains.{key} = {shown(value)}: expected a finite number >= 0, or one per axis")
    return np.array(values, dtype=np.float64)


def _checked_gains(law: LawConfig, known: dict[str, Any], n_axes: int) -> dict[str, Any]:
    gains = law.effective_gains()
    unknown = [key for key in gains if key not in known]
    if unknown:
        raise ValueError(f"law.gains.{unknown[0]}: {law.name} has {', '.join(known)}")
    return {key: _gain(key, value, n_axes, known[key]) for key, value in gains.items()}


def make_law(
    law: LawConfig, model: Model, period: float, force_limit: Array, repeat: tuple[int, int] | None = None
) -> Law:
    """The rig's law on arrays (..., n_axes), with its effective gains; period in s, force_limit (n_axes,) in N.

    repeat: (period, first start) of a repeated task in ns of task time, needed where law.iterative_learning is set; see
    hil.control.trajectories.task_repeat. Raises ValueError naming the key, its value and what is allowed.
    """
    return _construct(law, _known_gains(law, model.mass.shape[-1]), model, period, force_limit, repeat)


def make_axis_laws(
    law: LawConfig, model: Any, period: float, force_limit: Array, repeat: tuple[int, int] | None = None
) -> AxisLaws:
    """As make_law, from a Model of arrays (n_axes,), for one rig on plain floats; the same bits at a fraction of the
    cost.
    """
    gains = _known_gains(law, model.mass.size)
    axes = [
        _construct(law, _axis_gains(gains, axis), axis_model(model, axis), period, float(force_limit[axis]), repeat)
        for axis in range(model.mass.size)
    ]
    return Coupled(law, model, period, force_limit, repeat) if axes[0].coupled else PerAxis(axes)


def _known_gains(law: LawConfig, n_axes: int) -> dict[str, Any]:
    if law.name not in LAWS:
        raise ValueError(f"law.name = {law.name!r}: the laws are {', '.join(LAWS)}")
    return _checked_gains(law, {**LAWS[law.name].GAINS, **LEARNING_GAINS}, n_axes)


def _axis_gains(gains: dict[str, Any], axis: int) -> dict[str, Any]:
    return {key: value if isinstance(value, str) else float(value[axis]) for key, value in gains.items()}


def _construct(
    law: LawConfig,
    gains: dict[str, Any],
    model: Model,
    period: float,
    force_limit: Number,
    repeat: tuple[int, int] | None,
) -> Law:
    learning = {key: gains[key] for key in LEARNING_GAINS if key in gains}
    own = {key: value for key, value in gains.items() if key not in learning}
    inner = LAWS[law.name](model, period, force_limit, **own)
    if not law.iterative_learning:
        return inner
    learning = {f"learning_{key}": own[key] for key in ("kp", "kd") if key in own} | learning
    if repeat is None:
        raise ValueError(
            "law.iterative_learning = true: the task does not repeat (circle, lissajous, point_to_point do)"
        )
    return IterativeLearning(inner, model, period, force_limit, *repeat, **learning)
