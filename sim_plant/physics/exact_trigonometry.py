"""Sine and cosine of an angle in turns, the same to the last bit on every machine, for floats and arrays alike.

`math.sin` and `np.sin` are free to differ between C libraries and SIMD variants. These use only + - * and rounding to
the nearest integer, each of which IEEE 754 defines exactly. One turn is 2 pi rad, so the range reduction is exact. The
absolute error is below 4e-16 for |x| < 2**51 turns.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TURN: Final = 6.283185307179586  # rad, 2 pi rounded to double
# 1.5 * 2**52: adding and subtracting it rounds to the nearest integer, as rint does
_TO_INTEGER: Final = 6755399441055744.0


# of the Taylor series, highest power first: what _sine and _cosine have written out
_SINE = (
    2.8114572543455206e-15,
    -7.647163731819816e-13,
    1.6059043836821613e-10,
    -2.505210838544172e-08,
    2.7557319223985893e-06,
    -0.0001984126984126984,
    0.008333333333333333,
    -0.16666666666666666,
)
_COSINE = (
    -1.5619206968586225e-16,
    4.779477332387385e-14,
    -1.1470745597729725e-11,
    2.08767569878681e-09,
    -2.755731922398589e-07,
    2.48015873015873e-05,
    -0.001388888888888889,
    0.041666666666666664,
)


def _sine(angle: float) -> float:
    # Taylor series of sin up to x^17; on |x| <= pi/4 the remainder is below 1e-19.
    x2 = angle * angle
    series = -7.647163731819816e-13 + x2 * 2.8114572543455206e-15
    series = 1.6059043836821613e-10 + x2 * series
    series = -2.505210838544172e-08 + x2 * series
    series = 2.7557319223985893e-06 + x2 * series
    series = -0.0001984126984126984 + x2 * series
    series = 0.008333333333333333 + x2 * series
    series = -0.16666666666666666 + x2 * series
    return angle + angle * (x2 * series)


def _cosine(angle: float) -> float:
    # Taylor series of cos up to x^18; on |x| <= pi/4 the remainder is below 1e-20.
    x2 = angle * angle
    series = 4.779477332387385e-14 + x2 * -1.5619206968586225e-16
    series = -1.1470745597729725e-11 + x2 * series
    series = 2.08767569878681e-09 + x2 * series
    series = -2.755731922398589e-07 + x2 * series
    series = 2.48015873015873e-05 + x2 * series
    series = -0.001388888888888889 + x2 * series
    series = 0.041666666666666664 + x2 * series
    return 1.0 + x2 * (x2 * series - 0.5)


def sincos_turns(turns: float) -> tuple[float, float]:
    """Sine and cosine of one angle in turns, |turns| < 2**51; NaN if not finite."""
    fraction = turns - (turns + _TO_INTEGER - _TO_INTEGER)
    quarter = 4.0 * fraction + _TO_INTEGER - _TO_INTEGER
    angle = (fraction - 0.25 * quarter) * TURN
    sine, cosine = _sine(angle), _cosine(angle)
    if quarter == 0.0:
        return sine, cosine
    if quarter == 1.0:
        return cosine, -sine
    if quarter == -1.0:
        return -cosine, sine
    return -sine, -cosine


def sincos_turns_array(turns: Array) -> tuple[Array, Array]:
    """As sincos_turns, element by element, with bit-identical results; any shape, new arrays."""
    fraction = turns - np.rint(turns)
    quarter = np.rint(4.0 * fraction)
    angle = (fraction - 0.25 * quarter) * TURN
    sine, cosine = _sine_array(angle), _cosine_array(angle)
    odd = np.abs(quarter) == 1.0
    swapped_sine = np.where(odd, cosine, sine)
    swapped_cosine = np.where(odd, sine, cosine)
    flip = np.abs(quarter) == 2.0
    # sin changes sign in quarters -1 and +-2, cos in +1 and +-2.
    return (
        np.where(flip | (quarter == -1.0), -swapped_sine, swapped_sine),
        np.where(flip | (quarter == 1.0), -swapped_cosine, swapped_cosine),
    )


def sin_turns(turns: float) -> float:
    """Sine of one angle given in turns, with the bits of sincos_turns in half of its time; NaN if not finite."""
    fraction = turns - (turns + _TO_INTEGER - _TO_INTEGER)
    quarter = 4.0 * fraction + _TO_INTEGER - _TO_INTEGER
    angle = (fraction - 0.25 * quarter) * TURN
    if quarter == 0.0:
        return _sine(angle)
    if quarter == 1.0:
        return _cosine(angle)
    if quarter == -1.0:
        return -_cosine(angle)
    return -_sine(angle)


def sin_turns_array(turns: Array) -> Array:
    """Sine of angles given in turns, any shape, bit-identical to sin_turns; each polynomial only where it is needed."""
    fraction = np.rint(turns)
    np.subtract(turns, fraction, out=fraction)
    quarter = np.rint(4.0 * fraction)
    angle = 0.25 * quarter
    np.subtract(fraction, angle, out=angle)
    angle *= TURN
    odd = np.nonzero(np.abs(quarter) == 1.0)
    if odd[0].size == angle.size:
        sine = _cosine_array(angle)
    else:
        sine = _sine_array(angle)
        sine[odd] = _cosine_array(angle[odd])
    np.negative(sine, out=sine, where=(quarter == -1.0) | (np.abs(quarter) == 2.0))
    return sine


def _sine_array(angle: Array) -> Array:
    """As _sine, in one array."""
    x2 = angle * angle
    series = _series(x2, _SINE)
    series *= x2
    series *= angle
    series += angle
    return series


def _cosine_array(angle: Array) -> Array:
    """As _cosine, in one array."""
    x2 = angle * angle
    series = _series(x2, _COSINE)
    series *= x2
    series -= 0.5
    series *= x2
    series += 1.0
    return series


def _series(x2: Array, coefficients: tuple[float, ...]) -> Array:
    first, *others = coefficients
    series = first * x2
    for coefficient in others[:-1]:
        series += coefficient
        series *= x2
    series += others[-1]
    return series
