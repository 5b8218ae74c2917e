"""Friction that varies with a known period along the travel, as where rolling elements pass: learnt as a sine and a
cosine for each direction of motion.

A table over the travel is too coarse for it, and the observer's disturbance is too late: at 60 mm/s, 0.6 mm pass at
100 Hz. So what is learnt are amplitudes, from the observer's innovations. They are held against the innovations that
the sine itself makes, so that nothing is late. Written for floats and arrays.

Each direction is a filter of its own. Over a period sine and cosine are at right angles to each other, so both have one
variance, and no covariance.
"""

from typing import Any

from hil.control.gain import TINIEST
from hil.control.laws.breakaway import anywhere
from hil.control.laws.motion_observer import Channel, Gains, MotionModel
from hil.control.number import Number, at_least, bounded, full_like, select, zeros_like

WAVES = 4  # amplitudes: sine and cosine forwards, then backwards
COARSEST = 4.0  # pitches of the table: it learns longer periods by itself
LIMIT = 0.5  # of the friction: an amplitude
PRIOR, WALK = 0.1, 5e-4  # of the friction: standard deviations at the start, and gained in a period
NOISE = 0.06  # of the friction: what an innovation has besides
FASTEST = 0.25  # of the period, that the reference moves in a tick: forces that are held cannot follow faster ones
ROUNDER = 6755399441055744.0  # 1.5 * 2^52: added and taken away, it leaves the nearest whole number
SINE = (6.2780687, -15.9589524, 13.8806786)  # of turns and their square, beside what is 0 at 0 and half a turn

Waves = tuple[Number, Number, Number, Number]


def sine(turns: Number) -> Number:
    """sin(2 pi turns), within 3e-4; of up to 1e12 turns."""
    part = turns - ((turns + ROUNDER) - ROUNDER)
    square = part * part
    return part * (1.0 - 4.0 * square) * (SINE[0] + square * (SINE[1] + square * SINE[2]))


def fine(period: Number, pitch: Number) -> Any:
    """Whether friction of that period (m; 0: none) is too fine for a table of that pitch (m)."""
    return (period > 0.0) & (period < COARSEST * pitch)


class FrictionWave:
    """Amplitudes of one axis, or many, N."""

    def __init__(self, period: Number, pitch: Number, friction: Number, motion: MotionModel) -> None:
        """period: m, 0: none. pitch: of the table beside it, m. friction: N."""
        none = zeros_like(friction)
        learns = fine(period, pitch)
        one = full_like(none, 1.0)
        self.anywhere = anywhere(learns)
        self._there = select(learns, one, none)
        self._density = self._there / select(learns, period, one)
        self._motion, self._limit = motion, LIMIT * friction
        prior, walk, noise = PRIOR * friction, WALK * friction, NOISE * friction * motion.e_d
        self._prior, self._walk, self._noise = prior * prior, walk * walk, noise * noise
        self.reset(none)

    def reset(self, zero: Number) -> None:
        """Nothing is known."""
        self._channels = [Channel(zero) for _ in range(WAVES)]
        self._amplitudes: Waves = (zero, zero, zero, zero)
        self._coming, self._acting = self._amplitudes, self._amplitudes  # regressors after the sample, and before it
        self._forward, self._backward = zero + self._prior, zero + self._prior  # variances

    def values(self) -> list[Number]:
        """The amplitudes."""
        return list(self._amplitudes)

    def fill(self, values: list[Number]) -> None:
        """Begin with these."""
        limit = self._limit
        self._amplitudes = (
            bounded(values[0], limit), bounded(values[1], limit), bounded(values[2], limit), bounded(values[3], limit),
        )  # fmt: skip

    def force(self, place: Number, way: Number, turned: Number) -> Number:
        """What is learnt of the coming interval, N. place: at its middle, m. way: of the reference through it, m.
        turned: friction's share forwards, 0 to 1.
        """
        turns, none = place * self._density, zeros_like(self._there)
        there = select(abs(way) * self._density < FASTEST, self._there, none)
        s, c = sine(turns) * there, sine(turns + 0.25) * there
        back = 1.0 - turned
        self._coming = (turned * s, turned * c, back * s, back * c)
        w, z = self._amplitudes, self._coming
        return w[0] * z[0] + w[1] * z[1] + w[2] * z[2] + w[3] * z[3]

    def learn(self, innovation: Number, learn: Number, calm: Number, gains: Gains) -> None:
        """From the innovation (m) of the interval before the sample; see FrictionWeights.learn. calm: share of its
        variance that the ringing mode has not made.
        """
        acting, motion, c = self._acting, self._motion, self._channels
        self._acting = self._coming
        r0, r1 = c[0].innovation(acting[0], motion, gains), c[1].innovation(acting[1], motion, gains)
        r2, r3 = c[2].innovation(acting[2], motion, gains), c[3].innovation(acting[3], motion, gains)
        w, noise = self._amplitudes, self._noise / at_least(calm, TINIEST)
        forward, backward = self._forward, self._backward
        ahead, back = r0 * r0 + r1 * r1, r2 * r2 + r3 * r3
        scale = learn * self._there * innovation / (noise + forward * ahead + backward * back)
        more, less = forward * scale, backward * scale
        self.fill([w[0] + more * r0, w[1] + more * r1, w[2] + less * r2, w[3] + less * r3])
        self._forward = self._less(forward, noise, ahead, learn)
        self._backward = self._less(backward, noise, back, learn)

    def _less(self, variance: Number, noise: Number, seen: Number, learn: Number) -> Number:
        """Variance after an innovation: each tells of one amplitude of two."""
        kept = variance - learn * 0.5 * variance * variance * seen / (noise + variance * seen)
        return kept + learn * select(variance < self._prior, self._walk, zeros_like(variance))
