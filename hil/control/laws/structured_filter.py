"""Arithmetic of the structured Kalman filter, one axis: written once with + - * / and abs, for floats and for arrays.

A single rig runs it on plain floats, axis by axis, a batch on arrays of any shape; IEEE 754 gives both the same bits.
See hil/control/laws/structured_kalman.py for the model. The transition is sparse: only the error and its rate change,
so a covariance step is two rows and, by symmetry, one 2 x 2 block.
"""

from typing import Any, cast

import numpy as np

from hil.control.laws.base import Array
from hil.control.number import Number, at_least, root, where

TINY = 1e-300  # keeps 0 / 0 from happening where the reference rests
INSTANT = 1e-15  # s, likewise for intervals of no length
NOTHING = np.zeros(())
# A reversal later than this fraction of an interval costs less position with the old force kept (then the axis waits)
# than with the new one taken at once: f = (1 - f)^2 + (1 - f).
LATE = 0.5857864376269049

# Plain tuples: naming their fields would cost more time than the arithmetic.

# The reference over an interval: length (s), increments (m, m/s), first velocity, the means of sgn(velocity), velocity
# and acceleration, mean force (N) that stiction takes beyond Coulomb's, and position (m) lost to the reversal's course.
Interval = tuple[Number, Number, Number, Number, Number, Number, Number, Number, Number]

Disturbance = tuple[Number, Number, Number, Number]  # d0 (N), theta1 (N), theta2 (N s/m), theta3 (kg)

# Upper triangle of P over [e, ė, d0, theta1, theta2, theta3], by rows: p00 p01 ... p05 p11 ... p15 p22 ... p55.
Covariance = tuple[
    Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number,
    Number, Number, Number, Number, Number, Number, Number,
]  # fmt: skip

Gains = tuple[Number, Number, Number, Number, Number, Number]  # of the state's elements, in their order
# Variances per second of ė; of ė at a reversal, over the square of the speed gained there; per second of d0 and thetas.
Noise = tuple[Number, Number, Number, Number, Number, Number]


def diagonal(p00: Number, p11: Number, p22: Number, p33: Number, p44: Number, p55: Number) -> Covariance:
    """A covariance without correlations."""
    o = p00 - p00
    return (p00, o, o, o, o, o, p11, o, o, o, o, p22, o, o, o, p33, o, o, p44, o, p55)


def interval(
    mass: Number, coulomb: Number, time: Number, position: Number, velocity: Number, to_position: Number,
    to_velocity: Number,
) -> Interval:  # fmt: skip
    """Between two instants of the reference, for that mass and Coulomb friction."""
    time = time + INSTANT
    moved = to_position - position
    gained = to_velocity - velocity
    mean_sign, stuck, shift = mean_sign_over(velocity, to_velocity, time, mass, coulomb)
    return time, moved, gained, velocity, mean_sign, moved / time, gained / time, stuck, shift


def mean_sign_over(
    v0: Number, v1: Number, time: Number, mass: Number, coulomb: Number
) -> tuple[Number, Number, Number]:
    """sign_float or sign_array, whichever fits."""
    if isinstance(coulomb, float):
        return sign_float(v0, v1, time, mass, coulomb)
    return sign_array(v0, v1, time, mass, coulomb)


def sign_float(v0: float, v1: float, time: float, mass: float, coulomb: float) -> tuple[float, float, float]:
    """Mean sgn(velocity) under a constant force that takes the axis from v0 to v1; stuck force; lost position."""
    if v0 * v1 >= 0.0:
        return (v0 + v1) / (abs(v0) + abs(v1) + TINY), 0.0, 0.0
    a0, a1 = abs(v0), abs(v1)
    direction = 1.0 if v1 > 0.0 else -1.0
    coulomb = coulomb if coulomb > 0.0 else 0.0
    if a0 * (1.0 - LATE) > LATE * a1 and mass * (a0 + a1) < coulomb * time:
        return -direction, mass * v1 / time, _late_shift(v0, a1, a0 + a1, time)
    mean = _early_sign(a0, a1, mass / time, coulomb)
    return direction * mean, 0.0, _early_shift(v0, v1, mean, time)


def sign_array(v0: Any, v1: Any, time: Any, mass: Any, coulomb: Any) -> tuple[Array, Array, Array]:
    """As sign_float, element by element, with bit-identical results."""
    a0, a1 = np.abs(v0), np.abs(v1)
    plain = (v0 + v1) / (a0 + a1 + TINY)
    reverses = v0 * v1 < 0.0
    if not reverses.any():
        return plain, NOTHING, NOTHING
    direction = where(v1 > 0.0, 1.0, -1.0)
    coulomb = np.maximum(coulomb, 0.0)
    late = reverses & (a0 * (1.0 - LATE) > LATE * a1) & (mass * (a0 + a1) < coulomb * time)
    safe = where(reverses, a0 + a1, 1.0)  # the other elements' results are not used
    mean = _early_sign(where(reverses, a0, safe), a1, mass / time, coulomb)
    early = reverses & ~late
    return (
        where(early, direction * mean, where(late, -direction, plain)),
        where(late, mass * v1 / time, 0.0),
        where(early, _early_shift(v0, v1, mean, time), where(late, _late_shift(v0, a1, safe, time), 0.0)),
    )


def _early_sign(a0: Number, a1: Number, push: Number, coulomb: Number) -> Number:
    """A force that flips with the interval stops the axis at once: friction then acts the new way most of the time.

    From v0 the axis is stopped by force and friction together, then driven to v1 against friction; the force that does
    both in the interval solves a quadratic. Without friction this is (|v1| - |v0|) / (|v1| + |v0|).
    """
    both, more = push * (a0 + a1), coulomb + push * (a1 - a0)
    # Never below 0 but by rounding.
    return 2.0 * more / (root(at_least(both * both + 4.0 * coulomb * more, 0.0)) + both + TINY)


def _early_shift(v0: Number, v1: Number, mean: Number, time: Number) -> Number:
    share = 0.5 * (1.0 - mean)  # of the interval, until the axis stops
    return -0.5 * time * (v0 * (1.0 - share) + v1 * share)


def _late_shift(v0: Number, a1: Number, both: Number, time: Number) -> Number:
    """The old force goes on: the axis stops where the reference reverses, and friction holds it to the end."""
    return -0.5 * time * v0 * (a1 / both)


def force_of(d: Disturbance, mean_sign: Number, mean_velocity: Number, mean_acceleration: Number) -> Number:
    """d0 + theta1 sgn(v) + theta2 v + theta3 a, N."""
    bias, coulomb, viscous, mass = d
    return bias + coulomb * mean_sign + viscous * mean_velocity + mass * mean_acceleration


def peak(mean_sign: Number, mean_velocity: Number, slowness: Number) -> Number:
    """sgn(v) / (1 + (slowness v)^2), slowness in s/m: friction that falls with speed from its peak at rest (Stribeck).

    The rational form of Hess and Soom (J. Tribology 112, 1990), in Armstrong-Helouvry, Dupont, Canudas de Wit,
    Automatica 30(7), 1994, section 2.
    """
    ratio = mean_velocity * slowness
    return mean_sign / (1.0 + ratio * ratio)


def keep_disturbance(p: Covariance, before: Covariance, kept: Any) -> Covariance:
    """P with the block of d0, theta1, theta2 and theta3 as it was `before`, where `kept`.

    The same as noise on them of just what was learnt: P stays positive semidefinite.
    """
    b = before
    both = (
        p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], p[10],
        b[11], b[12], b[13], b[14], b[15], b[16], b[17], b[18], b[19], b[20],
    )  # fmt: skip  # element by element: compiled code would make objects of slices
    return choose(kept, both, p)


def standing(before: Covariance, measurement: Number) -> Covariance:
    """P of an axis that is seen to stand: its error as uncertain as a sample (variance, m^2), its rate known, and
    neither a word about the disturbance, of which nothing new is known.
    """
    o = before[0] - before[0]
    b = before
    return (
        measurement + o, o, o, o, o, o, o, o, o, o, o,
        b[11], b[12], b[13], b[14], b[15], b[16], b[17], b[18], b[19], b[20],
    )  # fmt: skip


def choose(condition: Any, p: Covariance, otherwise: Covariance) -> Covariance:
    """One P or the other, element by element."""
    if isinstance(condition, bool):
        return p if condition else otherwise
    return cast(Covariance, tuple(where(condition, one, other) for one, other in zip(p, otherwise, strict=True)))


def move(error: Number, rate: Number, net: Number, inverse_mass: Number, over: Interval) -> tuple[Number, Number]:
    """Error and its rate at the end of an interval in which the net force (N) on the mass was constant.

    The plant moves as a double integrator, the reference by its exact increments.
    """
    time, moved, gained, velocity, _, _, _, _, shift = over
    speed = net * inverse_mass * time
    error = error + ((rate + velocity + 0.5 * speed) * time - moved + shift)
    return error, rate + (speed - gained)


def slide(velocity: Number, push: Number, dry: Number, time: Number, inverse_mass: Number) -> tuple[Number, Number]:
    """Speed after `time` and the way made, of a mass under a constant push (N) against dry friction (N, >= 0).

    Set-valued friction: an axis that stops stays at rest unless the push overcomes it. An estimate that took friction
    from the reference's sign alone would learn from an axis that has not broken away yet.
    """
    if isinstance(velocity, float):
        onward = velocity > 0.0 or (velocity == 0.0 and push > 0.0)
        slowing = (push - dry if onward else push + dry) * inverse_mass
        end = velocity + slowing * time
        if end >= 0.0 if onward else end <= 0.0:
            return end, 0.5 * (velocity + end) * time
        stop = -velocity / slowing
        left = time - stop
        beyond = push - dry if push > dry else push + dry if push < -dry else 0.0
        end = beyond * inverse_mass * left
        return end, 0.5 * (velocity * stop + end * left)
    onward = (velocity > 0.0) | ((velocity == 0.0) & (push > 0.0))
    slowing = where(onward, push - dry, push + dry) * inverse_mass
    end = velocity + slowing * time
    way = 0.5 * (velocity + end) * time
    stops = ~where(onward, end >= 0.0, end <= 0.0)
    if not stops.any():
        return end, way
    stop = -velocity / where(stops, slowing, 1.0)
    left = time - stop
    beyond = where(push > dry, push - dry, where(push < -dry, push + dry, 0.0))
    turned = beyond * inverse_mass * left
    return where(stops, turned, end), where(stops, 0.5 * (velocity * stop + turned * left), way)


def predict(p: Covariance, noise: Noise, inverse_mass: Number, over: Interval, third: Number) -> Covariance:
    """P <- F P F' + Q.

    third: what theta2 multiplies. The thetas drift only in motion. Where the reference reverses, the plant stops a
    little early or late and friction holds it meanwhile: its speed is uncertain there, and the thetas are not to blame.
    """
    p00, p01, p02, p03, p04, p05, p11, p12, p13, p14, p15, p22, p23, p24, p25, p33, p34, p35, p44, p45, p55 = p
    time, _, gained, before, s, _, a, _, _ = over
    after = before + gained
    v = third
    g = time * inverse_mass
    half = 0.5 * time
    # Rows: the rate loses what the disturbance takes; the error gains the mean of the rate before and after.
    r10 = p01 - g * (p02 + s * p03 + v * p04 + a * p05)
    r11 = p11 - g * (p12 + s * p13 + v * p14 + a * p15)
    n12 = p12 - g * (p22 + s * p23 + v * p24 + a * p25)
    n13 = p13 - g * (p23 + s * p33 + v * p34 + a * p35)
    n14 = p14 - g * (p24 + s * p34 + v * p44 + a * p45)
    n15 = p15 - g * (p25 + s * p35 + v * p45 + a * p55)
    r00 = p00 + half * (p01 + r10)
    r01 = p01 + half * (p11 + r11)
    n02 = p02 + half * (p12 + n12)
    n03 = p03 + half * (p13 + n13)
    n04 = p04 + half * (p14 + n14)
    n05 = p05 + half * (p15 + n15)
    # Columns, of the leading block.
    n01 = r01 - g * (n02 + s * n03 + v * n04 + a * n05)
    n11 = r11 - g * (n12 + s * n13 + v * n14 + a * n15)
    n00 = r00 + half * (r01 + n01)
    rate, reversal, bias, coulomb, viscous, mass = noise
    # The speed gained where the reference reverses, falling with the distance from it. What is then wrong with the
    # rate moves the error for the rest of the interval: the very next sample tells of it.
    squared, begun, ended = gained * gained, before * before, after * after + TINY
    total = begun + ended
    rest = time * (ended / total)
    jump = reversal * (squared * (squared / total))
    moved = rest * jump
    rate = rate * time
    moving = s * s * time
    return (
        n00 + rest * moved, n01 + moved, n02, n03, n04, n05, n11 + jump + rate, n12, n13, n14, n15,
        p22 + bias * time, p23, p24, p25,
        p33 + coulomb * moving, p34, p35, p44 + viscous * moving, p45, p55 + mass * moving,
    )  # fmt: skip


def update(p: Covariance, measurement: Number, fresh: Number) -> tuple[Covariance, Gains]:
    """P <- (I - K H) P and K (6), for a position sample of variance `measurement` (m^2); nothing where fresh is 0."""
    p00, p01, p02, p03, p04, p05, p11, p12, p13, p14, p15, p22, p23, p24, p25, p33, p34, p35, p44, p45, p55 = p
    scale = fresh / (p00 + measurement + TINY)
    k0, k1, k2, k3, k4, k5 = scale * p00, scale * p01, scale * p02, scale * p03, scale * p04, scale * p05
    return (
        p00 - k0 * p00, p01 - k0 * p01, p02 - k0 * p02, p03 - k0 * p03, p04 - k0 * p04, p05 - k0 * p05,
        p11 - k1 * p01, p12 - k1 * p02, p13 - k1 * p03, p14 - k1 * p04, p15 - k1 * p05,
        p22 - k2 * p02, p23 - k2 * p03, p24 - k2 * p04, p25 - k2 * p05,
        p33 - k3 * p03, p34 - k3 * p04, p35 - k3 * p05, p44 - k4 * p04, p45 - k4 * p05, p55 - k5 * p05,
    ), (k0, k1, k2, k3, k4, k5)  # fmt: skip
