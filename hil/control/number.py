"""Numbers of either kind: a float (one axis of one rig) or an array (axes, plants, or both).

Filter and laws are written once, with + - * / and abs and the few functions here. A single rig runs them on floats,
axis by axis, which is an order of magnitude cheaper than arrays of four; a batch runs them on arrays. IEEE 754 gives
both the same bits. The compiled build reads what is written so a second time, with `Number = float`
(deploy/compiled/build.py): it must be true of that type as well.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

Number = Any  # float, or an array of float64; every function maps one kind to the same kind

# np.where by a type of its own: numpy's overloads mean the one that returns a tuple where the arguments are Any, and a
# compiled build (deploy/compiled.mk) believes them.
where: Callable[[Any, Any, Any], Any] = np.where


def zeros_like(value: Number) -> Number:
    """0 for every axis that the value has."""
    if isinstance(value, float):
        return 0.0
    return np.zeros_like(value) if isinstance(value, np.ndarray) else 0.0


def full_like(value: Number, fill: Number) -> Number:
    """`fill` for every axis that the value has."""
    return zeros_like(value) + fill


def copy(value: Number) -> Number:
    """The value as it is now: arrays are written anew by who owns them."""
    return value + 0.0


def bounded(value: Number, bound: Number) -> Number:
    """value limited to [-bound, bound]; NaN stays NaN."""
    if isinstance(value, float):
        return bound if value > bound else -bound if value < -bound else value
    return np.minimum(np.maximum(value, -bound), bound)


def at_least(value: Number, low: Number) -> Number:
    """The larger of both; NaN stays NaN."""
    if isinstance(value, float):
        return low if value < low else value
    return np.maximum(value, low)


def at_most(value: Number, high: Number) -> Number:
    """The smaller of both; NaN stays NaN."""
    if isinstance(value, float):
        return high if value > high else value
    return np.minimum(value, high)


def select(condition: Any, then: Number, otherwise: Number) -> Number:
    """`then` where the condition holds, else `otherwise`; both have been evaluated."""
    if isinstance(condition, bool):
        return then if condition else otherwise
    chosen: Number = where(condition, then, otherwise)
    return chosen


def anywhere(condition: Any) -> bool:
    """Whether the condition holds for any of the axes."""
    if isinstance(condition, bool):
        return condition
    return bool(condition.any())


def root(value: Number) -> Number:
    """Square root; NaN below 0."""
    if isinstance(value, float):
        return math.sqrt(value) if value >= 0.0 else math.nan
    return np.sqrt(value)
