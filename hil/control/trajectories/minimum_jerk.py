"""Minimum-jerk transition (Flash and Hogan, J. Neuroscience 5(7), 1985): a quintic with rest at both ends."""

from hil.control.number import Number

Motion = tuple[Number, Number, Number]  # position, velocity, acceleration


def minimum_jerk(u: Number) -> tuple[Number, Number, Number]:
    """s, ds/du, d2s/du2 at the fraction u in [0, 1] of the transition; s runs from 0 to 1."""
    u2 = u * u
    rest = 1.0 - u
    s = u2 * u * (10.0 + u * (6.0 * u - 15.0))
    ds = 30.0 * (u2 * (rest * rest))
    dds = 60.0 * (u * rest) * (1.0 - 2.0 * u)
    return s, ds, dds


def entered(start: Number, motion: Motion, u: Number, per_second: float) -> Motion:
    """From rest at `start` into a motion (position, velocity, acceleration) at the fraction u of the transition:
    start + s (motion - start), with du/dt = per_second.
    """
    s, ds, dds = minimum_jerk(u)
    away, velocity, acceleration = motion[0] - start, motion[1], motion[2]
    s1, s2 = ds * per_second, dds * (per_second * per_second)
    return start + s * away, s1 * away + s * velocity, s2 * away + 2.0 * (s1 * velocity) + s * acceleration
