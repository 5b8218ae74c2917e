"""Noise that is the same in one stage and in a batch of them, on any machine: a function of seed, axis, effect, count.

Bits are SplitMix64's (Steele, Lea, Flood, OOPSLA 2014) at a counter, in arrays of 64-bit integers. A normal number is
the count of ones among 64 bits, less 32, plus a uniform number: mean 0 and variance exactly 1 after scaling, excess
kurtosis -0.03, never beyond 8. It needs no logarithm, which C libraries round differently.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sim_plant.physics.number import Number

Key = Any  # int, or an array of uint64
Bits = Any  # an array of uint64; numpy says of its products that they are signed

TORQUE, WALK, ENCODER, READING, CELL = range(1, 6)  # effects
BLOCK: Final = 64

_MASK = 2**64 - 1
_SCALE = 0.24935149047701485  # 1 / sqrt(16 + 1/12)


def _bits(key: Key) -> Bits:
    return np.atleast_1d(np.asarray(key, dtype=np.uint64))


def _mixed(z: Bits) -> Bits:
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9
    z = (z ^ z >> 27) * 0x94D049BB133111EB
    return z ^ z >> 31


def _key_of(seed: Bits, axis: Bits, effect: int) -> Bits:
    mixed = _mixed(seed * 0x9E3779B97F4A7C15 + 0x632BE59BD9B4E019)
    return _mixed(mixed + axis * 0xD1342543DE82EF95 + (effect * 0x2545F4914F6CDD1D & _MASK))


def _normal(key: Bits, count: Bits) -> NDArray[np.float64]:
    """The count-th number of a stream: mean 0, variance 1."""
    place = count * 0x9E3779B97F4A7C15
    ones, more = _mixed(key + place), _mixed(key + place ^ _MASK)
    numbers: NDArray[np.float64] = np.bitwise_count(ones).astype(np.float64) - 32.0 + ((more >> 11) * 2.0**-53 - 0.5)
    return numbers * _SCALE


def uniform_of(key: int, count: int) -> float:
    """The count-th number, in [0, 1), that a stream's `key` stands for."""
    place = np.array([count], dtype=np.uint64) * 0x9E3779B97F4A7C15
    return float((_mixed(_bits(key) + place) >> 11)[0] * 2.0**-53)


class Stream:
    """The numbers of one axis (seed and axis: integers; numbers: floats) or of many (arrays of uint64)."""

    def __init__(self, seed: Key, axis: Key, effect: int) -> None:
        self._is_single = isinstance(seed, int)
        self._key = _key_of(_bits(seed), _bits(axis), effect)
        # One axis draws a block of numbers at a time, which is many times as fast; not all axes in the same tick.
        self._offset = self.key % BLOCK
        self._begin = -BLOCK
        self._block: list[float] = []

    @property
    def key(self) -> int:
        """Of one axis: what its numbers are a function of, beside their count."""
        return int(self._key[0])

    def at(self, count: int) -> Number:
        """The count-th number, 0 <= count: mean 0, variance 1."""
        if not self._is_single:
            return _normal(self._key, np.array([count], dtype=np.uint64))
        place = (count + self._offset) % BLOCK
        if count - place != self._begin:
            self._begin = count - place  # of the first block perhaps below 0: those numbers are never asked for
            counts = np.arange(self._begin, self._begin + BLOCK).astype(np.uint64)
            self._block = _normal(self._key, counts).tolist()
        return self._block[place]
