"""Control laws, one per file, all with the signature of hil/control/laws/base.py; see `make_law`.

Their names are in hil/control/law_registry.py, which also finds the laws that users bring.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from drivers.base.guard import Guard
from drivers.base.toml_file import shown
from hil.control.gain import Gain, declared, not_taken
from hil.control.law_registry import PACKAGE, is_built_in, law_class
from hil.control.laws.base import Array, AxisLaws, Law, Model, axis_model
from hil.control.laws.coupled import Coupled, interpreted_axis_laws
from hil.control.laws.iterative_learning import LEARNING_GAINS, IterativeLearning
from hil.control.laws.per_axis import PerAxis
from hil.control.laws.users import OnArrays, PerElement, UserAxes
from hil.control.number import Number
from hil.rig.law_names import KIND
from hil.rig.schema import LawConfig

__all__ = ["AxisLawMaker", "designed_laws", "law_on_arrays", "make_axis_laws", "make_law"]


def _word(key: str, value: Any, gain: Gain) -> str:
    if not isinstance(value, str):
        raise ValueError(f"law.gains.{key} = {shown(value)}: expected a word such as {gain.default!r}")
    if gain.words and value not in gain.words:
        raise ValueError(f"law.gains.{key} = {value!r}: expected one of {', '.join(gain.words)}")
    return value


def _gain(key: str, value: Any, n_axes: int, gain: Gain) -> Any:
    """One gain as the law takes it: a word stays, a number or one per axis becomes (n_axes,). Raises ValueError."""
    if isinstance(gain.default, str):
        return _word(key, value, gain)
    values = value if isinstance(value, list | tuple | np.ndarray) else [value] * n_axes
    if len(values) != n_axes:
        raise ValueError(f"law.gains.{key} has {len(values)} values for {n_axes} axes")
    for item in values:
        is_number = isinstance(item, int | float) and not isinstance(item, bool)
        if not is_number or not gain.least <= item <= gain.most:
            raise ValueError(f"law.gains.{key} = {shown(value)}: expected {gain.allowed()}, or one per axis")
    return np.array(values, dtype=np.float64)


def _checked_gains(law: LawConfig, known: dict[str, Gain], n_axes: int) -> dict[str, Any]:
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
    gains = _known_gains(law, model.mass.shape[-1])
    made = _construct(law, law_on_arrays(law), gains, model, period, force_limit, repeat)
    if any(law.learnt_state):
        fresh = np.array(made.learnt_state()).T.tolist()  # of an axis of which nothing is kept
        states = [state or own for state, own in zip(law.learnt_state, fresh, strict=True)]
        made.begin_learnt([np.array(values) for values in zip(*states, strict=True)])
    return made


def make_axis_laws(
    law: LawConfig, model: Any, period: float, force_limit: Array, repeat: tuple[int, int] | None = None
) -> AxisLaws:
    """As make_law, from a Model of arrays (n_axes,), for one rig on plain floats; the same bits at a fraction of the
    cost.
    """
    if not is_built_in(law) and __name__ != PACKAGE:  # the compiled build: it inherits from no compiled class
        return interpreted_axis_laws(law, model, period, force_limit, repeat)
    maker = AxisLawMaker(law, model, period, force_limit, repeat)
    while not maker.work():
        pass
    return maker.made()


class AxisLawMaker:
    """make_axis_laws, an axis at a time where each has a law of its own: a tick of a rig that runs has no time for all.

    designed: by axis, what `designed_laws` says of laws that were made from the same arguments. Raises ValueError as
    make_axis_laws.
    """

    def __init__(
        self, law: LawConfig, model: Any, period: float, force_limit: Array, repeat: tuple[int, int] | None = None,
        designed: Sequence[Sequence[float]] = (),
    ) -> None:  # fmt: skip
        self._law, self._model, self._period, self._limit, self._repeat = law, model, period, force_limit, repeat
        self._designed, self._count = designed, int(model.mass.size)
        self._gains = _known_gains(law, self._count)
        made, self._ours = law_class(law, __name__), is_built_in(law)
        self._make = made if self._ours else _guarded(law, made)
        self._users_whole = not self._ours and bool(made.coupled)
        self._axes: list[Law] = []
        self._coupled: AxisLaws | None = None

    def work(self) -> bool:
        """One axis more. Returns whether all are made."""
        if self.whole:
            return True
        axis, law, period = len(self._axes), self._law, self._period
        if self._users_whole:
            whole = _construct(law, self._make, self._gains, self._model, period, self._limit, self._repeat)
            self._coupled = UserAxes([whole], law.name, self._count)
            return True
        gains = _axis_gains(self._gains, axis)
        if self._designed:
            gains["designed"] = list(self._designed[axis])
        model, limit = axis_model(self._model, axis), float(self._limit[axis])
        made = _construct(law, self._make, gains, model, period, limit, self._repeat)
        if law.learnt_state and law.learnt_state[axis]:
            made.begin_learnt(list(law.learnt_state[axis]))
        if made.coupled:
            self._coupled = Coupled(law, self._model, period, self._limit, self._repeat)
        else:
            self._axes.append(made)
        return self.whole

    @property
    def whole(self) -> bool:
        """Whether all axes are made."""
        return self._coupled is not None or len(self._axes) == self._count

    def made(self) -> AxisLaws:
        """What came of it, once `work` has said that all are made."""
        if self._coupled is not None:
            return self._coupled
        return PerAxis(self._axes) if self._ours else UserAxes(self._axes, self._law.name, self._count)


def designed_laws(laws: AxisLaws) -> list[list[float]]:
    """By axis, what took long to find for laws that were made here: `designed` of AxisLawMaker. Empty: nothing did."""
    found = [law.designed() for law in laws.laws] if isinstance(laws, PerAxis) else []
    return found if any(found) else []


def law_on_arrays(law: LawConfig) -> Callable[..., Law]:
    """What makes the law on arrays from (model, period, force_limit, **gains)."""
    made = law_class(law, __name__)
    if is_built_in(law):
        return made  # type: ignore[no-any-return]
    one = _guarded(law, made)

    def make(model: Model, period: float, force_limit: Array, **gains: Any) -> Law:
        if made.elementwise:
            return OnArrays(law.name, one(model, period, force_limit, **gains))
        return OnArrays(law.name, PerElement(made, model, period, force_limit, gains))

    return make


def _guarded(law: LawConfig, made: Callable[..., Law]) -> Callable[..., Law]:
    """What makes a user's law, in a limited time. Raises ValueError naming the key, and file and line."""
    return partial(Guard(KIND, law.name, made).call, "it cannot be made", made)


def _known_gains(law: LawConfig, n_axes: int) -> dict[str, Any]:
    made = law_class(law, __name__)
    if not issubclass(made, Law):
        raise ValueError(f"law.name = {shown(law.name)}: {made.__name__} does not inherit from hil.Law")
    learning = {} if is_built_in(law) and made.learns_repeats else LEARNING_GAINS
    try:
        known = declared(made.GAINS)
    except ValueError as error:
        raise ValueError(f"law.name = {shown(law.name)}: {error}") from None
    if not is_built_in(law) and (strange := not_taken(made, known)):
        names = ", ".join(strange)
        raise ValueError(
            f"law.name = {shown(law.name)}: GAINS has {names}, which {made.__name__}() does not take by name behind "
            "model, period and force_limit"
        )
    return _checked_gains(law, {**known, **learning}, n_axes)


def _axis_gains(gains: dict[str, Any], axis: int) -> dict[str, Any]:
    return {key: value if isinstance(value, str) else float(value[axis]) for key, value in gains.items()}


def _construct(
    law: LawConfig,
    make: Callable[..., Law],
    gains: dict[str, Any],
    model: Model,
    period: float,
    force_limit: Number,
    repeat: tuple[int, int] | None,
) -> Law:
    learning = {key: gains[key] for key in LEARNING_GAINS if key in gains}
    own = {key: value for key, value in gains.items() if key not in learning}
    inner = make(model, period, force_limit, **own)
    if not law.iterative_learning:
        return inner
    learning = {f"learning_{key}": own[key] for key in ("kp", "kd") if key in own} | learning
    if repeat is None:
        raise ValueError(
            "law.iterative_learning = true: the task does not repeat (circle, lissajous and point_to_point do; path, "
            "waypoints, spline, raster and spiral with task.repeat = true)"
        )
    if is_built_in(law) and inner.learns_repeats:
        inner.learn_repeats(*repeat)
        return inner
    return IterativeLearning(inner, model, period, force_limit, *repeat, **learning)
