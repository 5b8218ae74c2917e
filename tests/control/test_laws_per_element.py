"""PerElement: on arrays of plants, each law object computes what it computes alone, of the numbers of its own axis."""

from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from hil import Law
from hil.control.laws.base import LawInputs, Model, Reference
from hil.control.laws.coupled import PLAIN
from hil.control.laws.users import OnArrays, PerElement

GAINS = ("stiff", "soft")


class Remembers(Law):
    """A force of everything that a law is told, ever: any number that goes to another object shows."""

    coupled, preview = False, 2

    def __init__(self, model: Any, period: float, force_limit: Any, stiff: Any, soft: Any, mood: str) -> None:
        self._model, self._period, self._limit = model, period, force_limit
        self._gains, self._mood, self._sum = (stiff, soft), mood, 0.0

    def reset(self, position: Any, force: Any) -> None:
        self._sum = 2.0 * position - 3.0 * force

    def force(self, inputs: Any) -> Any:
        told = [getattr(self._model, field.name) for field in fields(Model)]
        told += [self._limit, *self._gains, self._sum]
        told += [getattr(inputs, name) for name in PLAIN]
        for reference in (inputs.sample, inputs.start, inputs.end, *inputs.preview):
            told += [reference.position, reference.velocity, reference.acceleration]
        asked = sum((number + 1) * value for number, value in enumerate(told)) * self._period + inputs.task_ns
        self._sum = self._sum + 0.5 * asked + len(self._mood)
        return asked


class RemembersAll(Remembers):
    """The same of all axes at once, where each feels the others."""

    coupled = True

    def force(self, inputs: Any) -> Any:
        own = super().force(inputs)
        assert own.ndim == 1
        return own + np.cumsum(own)


def drawn(random: np.random.Generator, shape: tuple[int, ...]) -> Any:
    return random.integers(-1000, 1000, shape) / 16.0


def references(random: np.random.Generator, shape: tuple[int, ...]) -> Reference:
    return Reference(*(drawn(random, shape) for _ in range(3)))


def inputs_of(random: np.random.Generator, shape: tuple[int, ...], task_ns: int) -> LawInputs:
    return LawInputs(
        sample=references(random, shape), start=references(random, shape), end=references(random, shape),
        task_ns=task_ns, preview=[references(random, shape) for _ in range(3)],
        **{name: drawn(random, shape) for name in PLAIN},
    )  # fmt: skip


def at(value: Any, index: Any) -> Any:
    """What one object is told of it, that of axis or plant `index`."""
    if isinstance(value, Reference):
        return Reference(value.position[index], value.velocity[index], value.acceleration[index])
    if isinstance(value, list):
        return [at(one, index) for one in value]
    return value[index]


def inputs_at(inputs: LawInputs, index: Any) -> LawInputs:
    names = (*PLAIN, "sample", "start", "end", "preview")
    return LawInputs(task_ns=inputs.task_ns, **{name: at(getattr(inputs, name), index) for name in names})


@pytest.mark.parametrize("law", [Remembers, RemembersAll])
@pytest.mark.parametrize("shape", [(2,), (1, 2), (3, 2), (4, 3, 2)])
def test_every_object_is_told_its_own(law: type[Law], shape: tuple[int, ...]) -> None:
    random = np.random.default_rng(sum(shape))
    model = Model(*(drawn(random, shape) for _ in fields(Model)))
    limit, gains = drawn(random, shape[-1:]), {"stiff": drawn(random, shape[-1:]), "soft": 2.5}
    whole = OnArrays("mine", PerElement(law, model, 1e-3, limit, {**gains, "mood": "calm"}))  # which ends its calls
    where = list(np.ndindex(shape[:-1] if law.coupled else shape))
    alone = [
        law(
            Model(*(at(getattr(model, field.name), index) for field in fields(Model))),
            1e-3,
            *(value if law.coupled else value[index[-1]] for value in (limit, gains["stiff"])),
            2.5,
            "calm",
        )  # type: ignore[call-arg]
        for index in where
    ]
    for _ in range(2):
        position, force = drawn(random, shape), drawn(random, shape)
        whole.reset(position, force)
        for index, one in zip(where, alone, strict=True):
            one.reset(position[index], force[index])
        for tick in range(3):
            inputs = inputs_of(random, shape, tick)
            asked = whole.force(inputs)
            assert asked.shape == shape
            for index, one in zip(where, alone, strict=True):
                assert np.array_equal(asked[index], one.force(inputs_at(inputs, index)))
