"""Laws that users bring: ordinary Python classes, run interpreted in every build, and trusted with nothing.

A law that raises, returns no number, a number that is not finite or an array of another shape, or does not return, asks
for NaN from then on. The cycle answers that as any request that is not finite: zero torque, and a fault. `failure` says
which line of which file it was. The next `reset` (the operator's, before another start) gives the law another chance.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drivers.base.guard import Guard, next_call
from hil.control.laws.base import Array, Law, LawInputs, Model, Reference
from hil.control.laws.coupled import PLAIN, gather
from hil.rig.law_names import KIND


class UserAxes:
    """AxisLaws (laws/base.py) of laws that users bring: one for each axis, or a single one of all axes.

    failure: why the law no longer counts, with file and line; empty where all is well.
    """

    def __init__(self, laws: Sequence[Law], name: str, n_axes: int) -> None:
        self._laws = list(laws)
        self._forces = [law.force for law in laws]
        self._n = n_axes
        self._limited = _guard(name, self._laws[0]).limited("force", self._fail)
        self._coupled = self._laws[0].coupled
        self._preview = max(law.preview for law in self._laws)
        self.failure = ""

    def reset(self, position: Sequence[float], force: Sequence[float]) -> None:
        """See AxisLaws."""
        self.failure = ""
        with self._limited:
            self._reset(position, force)

    def _fail(self, why: str) -> None:
        self.failure = why

    def _reset(self, position: Sequence[float], force: Sequence[float]) -> None:
        if self._coupled:
            self._laws[0].reset(np.array(position), np.array(force))
            return
        for law, q, tau in zip(self._laws, position, force, strict=True):
            law.reset(q, tau)

    def force(self, axes: Sequence[Any]) -> list[float]:
        """See AxisLaws; NaN for all axes where the law has failed."""
        if self._preview:
            for x in axes:
                if not x.preview:  # the first tick after the axes were engaged: they rest
                    x.preview = [_copy(x.start) for _ in range(self._preview + 1)]
        if not self.failure:
            with self._limited:
                return self._of_all(axes) if self._coupled else self._of_each(axes)
        return [math.nan] * self._n

    @property
    def denominator_floors(self) -> int:
        """See AxisLaws."""
        return sum(law.denominator_floors for law in self._laws)

    def _of_each(self, axes: Sequence[Any]) -> list[float]:
        asked: list[float] = []
        for force, x in zip(self._forces, axes, strict=True):
            value = force(x)
            if type(value) is not float:
                value = _number(value)
            if value - value != 0.0:
                raise ValueError(f"force returned {value} for axis {len(asked)}")
            asked.append(value)
        return asked

    def _of_all(self, axes: Sequence[Any]) -> list[float]:
        array = np.asarray(self._forces[0](gather(axes)), dtype=np.float64)
        if array.shape != (self._n,):
            raise TypeError(f"force returned an array of shape {array.shape}, expected ({self._n},)")
        if not np.isfinite(array).all():
            raise ValueError(f"force returned {array.tolist()}")
        asked: list[float] = array.tolist()
        return asked


def _guard(name: str, law: Any) -> Guard:
    """Of the class of a law that is made."""
    law = getattr(law, "_inner", law)  # inside iterative learning
    return Guard(KIND, name, law.made if isinstance(law, PerElement) else type(law))


def _number(value: Any) -> float:
    """A law's answer as a float. Raises TypeError where it is no number."""
    if value is None or isinstance(value, bool | str | bytes) or np.ndim(value):
        raise TypeError(f"force returned {value!r:.60}, expected a number")
    return float(value)


def _copy(reference: Any) -> Reference:
    return Reference(reference.position, reference.velocity, reference.acceleration)


class OnArrays(Law):
    """A user's law on arrays; whatever it raises, and that it does not return, is a ValueError that names the file and
    the line.
    """

    def __init__(self, name: str, inner: Law) -> None:
        self._inner = inner
        self._limited = _guard(name, inner).limited("force")
        self.coupled, self.preview = inner.coupled, inner.preview
        self.told_of_learning = inner.told_of_learning  # type: ignore[misc]
        self.stiffness, self.damping = inner.stiffness, inner.damping

    def reset(self, position: Any, force: Any) -> None:
        """See Law."""
        with self._limited:
            self._inner.reset(position, force)

    def force(self, inputs: LawInputs) -> Any:
        """See Law."""
        with self._limited:
            return self._inner.force(inputs)


class PerElement(Law):
    """A law on arrays (..., n_axes) made of one object for every axis of every plant, each on floats; or of one for
    every plant, on arrays (n_axes,), where the law is coupled. For laws that are not `elementwise`. Used inside
    OnArrays, which ends what does not return.
    """

    def __init__(
        self, law: type[Law], model: Model, period: float, force_limit: Array, gains: Mapping[str, Any]
    ) -> None:
        self.made = law
        self._model, self._period, self._limit, self._gains = model, period, force_limit, gains
        self.coupled = bool(law.coupled)
        self.preview = law.preview

    def reset(self, position: Array, force: Array) -> None:
        """See Law."""
        words = {key: value for key, value in self._gains.items() if isinstance(value, str)}
        numbers = {key: value for key, value in self._gains.items() if key not in words}
        shapes = [np.shape(value) for value in (position, self._model.mass, *numbers.values())]
        self._shape: tuple[int, ...] = np.broadcast_shapes(*shapes)
        model = [self._cells(getattr(self._model, name)) for name in Model.__dataclass_fields__]
        limits = self._cells(self._limit)
        columns = [self._cells(value) for value in numbers.values()]
        self._laws: list[Law] = []
        for index, limit in enumerate(limits):
            own = dict(zip(numbers, (column[index] for column in columns), strict=True))
            each = Model(*(column[index] for column in model))
            next_call()
            self._laws.append(self.made(each, self._period, limit, **own, **words))
        for law, q, tau in zip(self._laws, self._cells(position), self._cells(force), strict=True):
            next_call()
            law.reset(q, tau)

    def force(self, inputs: LawInputs) -> Array:
        """See Law."""
        plain = {name: self._cells(getattr(inputs, name)) for name in PLAIN}
        references = {name: self._references(getattr(inputs, name)) for name in ("sample", "start", "end")}
        preview = [self._references(reference) for reference in inputs.preview or ()]
        asked = []
        for index, law in enumerate(self._laws):
            one = LawInputs(
                task_ns=inputs.task_ns,
                preview=[column[index] for column in preview],
                **{name: column[index] for name, column in plain.items()},
                **{name: column[index] for name, column in references.items()},
            )
            next_call()
            asked.append(law.force(one))
        return np.array(asked, dtype=np.float64).reshape(self._shape)

    def _cells(self, value: Any) -> list[Any]:
        """A value of all as a list of what each law object gets: floats, or arrays (n_axes,)."""
        whole = np.asarray(value, dtype=np.float64)
        if whole.shape != self._shape:  # numpy takes 6 us even where there is nothing to do
            whole = np.broadcast_to(whole, self._shape)
        if self.coupled:
            return list(whole.reshape(-1, self._shape[-1]).copy())
        found: list[Any] = whole.reshape(-1).tolist()
        return found

    def _references(self, reference: Reference) -> list[Reference]:
        columns = (self._cells(getattr(reference, name)) for name in Reference.__dataclass_fields__)
        return [Reference(*values) for values in zip(*columns, strict=True)]
