"""Numbers of either kind: a float (one axis) or an array (many axes). One source of formulas serves both.

IEEE 754 gives both the same bits for + - * / and sqrt, and for what is composed of them here. The compiled build reads
the modules written so a second time, with `Number = float` (deploy/compiled/build.py).
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from sim_plant.physics.exact_trigonometry import sin_turns, sin_turns_array, sincos_turns, sincos_turns_array

Number = Any  # float, or an array of float64; every function maps one kind to the same kind

# by a type of its own: numpy's overloads name the variant that returns a tuple where the arguments are Any
_where: Callable[[Any, Any, Any], Any] = np.where


def select(condition: Any, then: Number, otherwise: Number) -> Number:
    """`then` where the condition holds, else `otherwise`; both have been evaluated."""
    if isinstance(condition, bool):
        return then if condition else otherwise
    chosen: Number = _where(condition, then, otherwise)
    return chosen


def greater(a: Number, b: Number) -> Number:
    """The larger of both."""
    if isinstance(a, float):
        return a if a > b else b
    return np.maximum(a, b)


def direction(value: Number) -> Number:
    """1.0 or -1.0: its sign, that of a zero included."""
    if isinstance(value, float):
        return math.copysign(1.0, value)
    return np.copysign(1.0, value)


def anywhere(condition: Any) -> bool:
    """Whether the condition holds for any of the axes."""
    if isinstance(condition, bool):
        return condition
    return bool(condition.any())


def root(value: Number) -> Number:
    """Square root of value >= 0."""
    if isinstance(value, float):
        return math.sqrt(value)
    return np.sqrt(value)


def sine(turns: Number) -> Number:
    """Sine of an angle in turns, |turns| < 2**51."""
    if isinstance(turns, float):
        return sin_turns(turns)
    return sin_turns_array(turns)


def sincos(turns: Number) -> tuple[Number, Number]:
    """Sine and cosine of an angle in turns, |turns| < 2**51."""
    if isinstance(turns, float):
        return sincos_turns(turns)
    return sincos_turns_array(turns)


def decay(a: Number) -> Number:
    """exp(-a) for a > -1 from + * / alone: the fourth power of 1 / (series of exp(a/4) up to the fourth power).

    Absolute error below 1e-6 for 0 <= a <= 0.5, 1e-5 at 1, never above 3e-4; in (0, 1] for a >= 0, to 0 for large a.
    """
    quarter = 1.0 / (1.0 + a * (0.25 + a * (0.03125 + a * (0.0026041666666666665 + a * 0.00016276041666666666))))
    square = quarter * quarter
    return square * square


def decay_with_mean(a: Number) -> tuple[Number, Number]:
    """`decay` of a, and its mean from 0 to a, (1 - decay(a)) / a, without the difference."""
    rising = 0.25 + a * (0.03125 + a * (0.0026041666666666665 + a * 0.00016276041666666666))
    quarter = 1.0 / (1.0 + a * rising)
    square = quarter * quarter
    return square * square, rising * quarter * (1.0 + quarter) * (1.0 + square)
