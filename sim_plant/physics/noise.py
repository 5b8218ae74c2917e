"""Noise that is the same in one stage and in a batch of them, on any machine: a function of seed, axis, effect, count.

Bits are SplitMix64's (Steele, Lea, Flood, OOPSLA 2014) at a counter, in integers or arrays of 64-bit integers alike. A
normal number is the count of ones among 64 bits, less 32, plus a uniform number: mean 0 and variance exactly 1 after
scaling, excess kurtosis -0.03, never beyond 8. It needs no logarithm, which C libraries round differently.
"""

from typing import Any

import numpy as np

from sim_plant.physics.number import Number

Key = Any  # int, or an array of uint64

TORQUE, WALK, ENCODER = range(1, 4)  # effects

_MASK = 2**64 - 1
_SCALE = 0.24935149047701485  # 1 / sqrt(16 + 1/12)


def _mixed(z: Key) -> Key:
    z = ((z ^ z >> 30) * 0xBF58476D1CE4E5B9) & _MASK
    z = ((z ^ z >> 27) * 0x94D049BB133111EB) & _MASK
    return z ^ z >> 31


def key_of(seed: Key, axis: Key, effect: int) -> Key:
    """Of a stream; seed and axis are integers, or arrays of uint64."""
    mixed = _mixed((seed * 0x9E3779B97F4A7C15 + 0x632BE59BD9B4E019) & _MASK)
    return _mixed((mixed + axis * 0xD1342543DE82EF95 + effect * 0x2545F4914F6CDD1D % 2**64) & _MASK)


def normal(key: Key, count: int) -> Number:
    """The count-th number of a stream: mean 0, variance 1."""
    place = count * 0x9E3779B97F4A7C15 & _MASK
    ones, more = _mixed((key + place) & _MASK), _mixed((key + place ^ _MASK) & _MASK)
    if isinstance(key, int):
        return (float(ones.bit_count() - 32) + (float(more >> 11) * 2.0**-53 - 0.5)) * _SCALE
    return (np.bitwise_count(ones).astype(np.float64) - 32.0 + ((more >> 11) * 2.0**-53 - 0.5)) * _SCALE
