"""Laws that run interpreted even in the compiled build: one that looks at all axes at once works on arrays, between
floats in and out; one that a user brings is an ordinary Python class.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hil.control.laws.base import Array, AxisLaws, LawInputs, Model, Reference
from hil.rig.schema import LawConfig

PLAIN = (
    "position", "fresh", "sample_interval", "ahead", "position_estimate", "velocity_estimate", "disturbance_estimate",
    "mean_velocity", "mean_acceleration", "mean_sign", "force_last", "force_before", "answered",
)  # fmt: skip


def gather(axes: Sequence[LawInputs]) -> LawInputs:
    """Inputs of every axis (floats) as one of arrays (n_axes,)."""

    def column(name: str) -> Any:
        return np.array([getattr(x, name) for x in axes])

    def reference(name: str) -> Reference:
        return _stacked([getattr(x, name) for x in axes])

    ahead = [x.preview for x in axes] if axes[0].preview else []
    preview = [_stacked(column) for column in zip(*ahead, strict=True)]
    return LawInputs(
        sample=reference("sample"), start=reference("start"), end=reference("end"), task_ns=axes[0].task_ns,
        preview=preview, readings=axes[0].readings, **{name: column(name) for name in PLAIN},
    )  # fmt: skip


def _stacked(each: Sequence[Reference]) -> Reference:
    """References of every axis (floats) as one of arrays (n_axes,)."""
    return Reference(
        np.array([r.position for r in each]),
        np.array([r.velocity for r in each]),
        np.array([r.acceleration for r in each]),
    )


def interpreted_axis_laws(
    law: LawConfig, model: Model, period: float, force_limit: Array, repeat: tuple[int, int] | None
) -> AxisLaws:
    """make_axis_laws as the interpreted source has it."""
    from hil.control.laws import make_axis_laws  # which imports this module

    return make_axis_laws(law, model, period, force_limit, repeat)


class Coupled:
    """AxisLaws by one law. Arguments: as make_law's."""

    def __init__(
        self, law: LawConfig, model: Model, period: float, force_limit: Array, repeat: tuple[int, int] | None
    ) -> None:
        from hil.control.laws import make_law  # which imports this module

        self._law = make_law(law, model, period, force_limit, repeat)
        self.failure = ""

    def reset(self, position: Sequence[float], force: Sequence[float]) -> None:
        """See AxisLaws."""
        self._law.reset(np.array(position), np.array(force))

    def force(self, axes: Sequence[Any]) -> list[float]:
        """See AxisLaws."""
        asked: list[float] = self._law.force(gather(axes)).tolist()
        return asked

    @property
    def denominator_floors(self) -> int:
        """See AxisLaws."""
        return self._law.denominator_floors
