"""A rig's law on plain floats: one law object an axis, or, where a law looks at all axes at once, one on arrays."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hil.config import LawConfig
from hil.laws.base import Array, Law, LawInputs, Model, Reference

_PLAIN = (
    "position", "fresh", "sample_interval", "ahead", "position_estimate", "velocity_estimate", "disturbance_estimate",
    "mean_velocity", "mean_acceleration", "mean_sign", "force_last", "force_before", "answered",
)  # fmt: skip


def gather(axes: Sequence[LawInputs]) -> LawInputs:
    """Inputs of every axis (floats) as one of arrays (n_axes,)."""

    def column(name: str) -> Any:
        return np.array([getattr(x, name) for x in axes])

    def reference(name: str) -> Reference:
        each: list[Reference] = [getattr(x, name) for x in axes]
        return Reference(
            np.array([r.position for r in each]),
            np.array([r.velocity for r in each]),
            np.array([r.acceleration for r in each]),
        )

    return LawInputs(
        sample=reference("sample"), start=reference("start"), end=reference("end"), task_ns=axes[0].task_ns,
        **{name: column(name) for name in _PLAIN},
    )  # fmt: skip


class PerAxis:
    """Laws that know nothing of each other, one an axis; `axes` in its methods are LawInputs of floats, one an axis."""

    def __init__(self, laws: Sequence[Law]) -> None:
        self._laws = list(laws)

    def reset(self, position: Sequence[float], force: Sequence[float]) -> None:
        """Bumpless start at rest at `position` (m) with `force` (N) now applied."""
        for law, q, tau in zip(self._laws, position, force, strict=True):
            law.reset(q, tau)

    def force(self, axes: Sequence[Any]) -> list[float]:
        """Force asked for on every axis, N."""
        return [law.force(inputs) for law, inputs in zip(self._laws, axes, strict=True)]

    @property
    def denominator_floors(self) -> int:
        """How often a law held a denominator at its floor, over all axes."""
        return sum([law.denominator_floors for law in self._laws])


class Coupled(PerAxis):
    """One law that looks at all axes at once. Arguments: as make_law's."""

    def __init__(
        self, law: LawConfig, model: Model, period: float, force_limit: Array, repeat: tuple[int, int] | None
    ) -> None:
        from hil.laws import make_law  # which imports this module

        super().__init__([make_law(law, model, period, force_limit, repeat)])

    def reset(self, position: Sequence[float], force: Sequence[float]) -> None:
        """As PerAxis."""
        self._laws[0].reset(np.array(position), np.array(force))

    def force(self, axes: Sequence[Any]) -> list[float]:
        """As PerAxis."""
        asked: list[float] = self._laws[0].force(gather(axes)).tolist()
        return asked
