"""Control laws by name, one per file, all with the signature of hil/laws/base.py; see `LAWS` and `make_law`."""

import math
from typing import Any

import numpy as np

from hil.config import LawConfig
from hil.laws.base import Array, Law, Model
from hil.laws.pd_feedforward import PdFeedforward
from hil.laws.structured_kalman import StructuredKalman

__all__ = ["LAWS", "make_law"]

LAWS: dict[str, type[Law]] = {law.name: law for law in (PdFeedforward, StructuredKalman)}


def _gain(key: str, value: Any, n_axes: int, default: Any) -> Any:
    """One gain as the law takes it: a word stays, a number or one per axis becomes (n_axes,). Raises ValueError."""
    if isinstance(default, str):
        if not isinstance(value, str):
            raise ValueError(f"law.gains.{key} = {value!r}: expected a word such as {default!r}")
        return value
    values = value if isinstance(value, list | tuple | np.ndarray) else [value] * n_axes
    if len(values) != n_axes:
        raise ValueError(f"law.gains.{key} has {len(values)} values for {n_axes} axes")
    for item in values:
        is_number = isinstance(item, int | float) and not isinstance(item, bool)
        if not is_number or not math.isfinite(item) or item < 0:
            raise ValueError(f"law.gains.{key} = {value!r}: expected a finite number >= 0, or one per axis")
    return np.array(values, dtype=np.float64)


def make_law(law: LawConfig, model: Model, period: float, force_limit: Array) -> Law:
    """The rig's law with its effective gains; period in s, force_limit (n_axes,) in N.

    Raises ValueError naming the key, its value and what is allowed.
    """
    if law.name not in LAWS:
        raise ValueError(f"law.name = {law.name!r}: the laws are {', '.join(LAWS)}")
    kind = LAWS[law.name]
    gains = law.effective_gains()
    unknown = [key for key in gains if key not in kind.GAINS]
    if unknown:
        raise ValueError(f"law.gains.{unknown[0]}: {law.name} has {', '.join(kind.GAINS)}")
    n_axes = model.mass.shape[-1]
    ready = {key: _gain(key, value, n_axes, kind.GAINS[key]) for key, value in gains.items()}
    return kind(model, period, force_limit, **ready)
