"""Arithmetic of the structured Kalman filter, one axis: written once with + - * / and abs, for floats and for arrays.

A single rig runs it on plain floats, axis by axis, a batch on arrays of any shape; IEEE 754 gives both the same bits.
See hil/laws/structured_kalman.py for the model. The transition is sparse: only the error and its rate change, so a
covariance step is two rows and, by symmetry, one 2 x 2 block.
"""

from typing import Any, NamedTuple

Number = Any  # float, or an array; every function maps one kind to the same kind

TINY = 1e-300  # keeps 0 / 0 from happening where the reference rests
INSTANT = 1e-15  # s, likewise for intervals of no length


class Interval(NamedTuple):
    """The reference over an interval: length (s), increments (m, m/s), first velocity, the regressors' means."""

    time: Number
    moved: Number
    gained: Number
    velocity: Number
    mean_sign: Number
    mean_velocity: Number
    mean_acceleration: Number


class Disturbance(NamedTuple):
    """d0 (N), theta1 (N), theta2 (N s/m), theta3 (kg)."""

    bias: Number
    coulomb: Number
    viscous: Number
    mass: Number


class Covariance(NamedTuple):
    """Upper triangle of P over [e, ė, d0, theta1, theta2, theta3]."""

    p00: Number
    p01: Number
    p02: Number
    p03: Number
    p04: Number
    p05: Number
    p11: Number
    p12: Number
    p13: Number
    p14: Number
    p15: Number
    p22: Number
    p23: Number
    p24: Number
    p25: Number
    p33: Number
    p34: Number
    p35: Number
    p44: Number
    p45: Number
    p55: Number


def interval(time: Number, position: Number, velocity: Number, to_position: Number, to_velocity: Number) -> Interval:
    """Between two instants of the reference. The sign's mean takes the velocity as linear in between."""
    time = time + INSTANT
    moved = to_position - position
    gained = to_velocity - velocity
    mean_sign = (velocity + to_velocity) / (abs(velocity) + abs(to_velocity) + TINY)
    return Interval(time, moved, gained, velocity, mean_sign, moved / time, gained / time)


def force_of(d: Disturbance, mean_sign: Number, mean_velocity: Number, mean_acceleration: Number) -> Number:
    """d0 + theta1 sgn(v) + theta2 v + theta3 a, N."""
    return d.bias + d.coulomb * mean_sign + d.viscous * mean_velocity + d.mass * mean_acceleration


def move(error: Number, rate: Number, net: Number, inverse_mass: Number, over: Interval) -> tuple[Number, Number]:
    """Error and its rate at the end of an interval in which the net force (N) on the mass was constant.

    The plant moves as a double integrator, the reference by its exact increments.
    """
    speed = net * inverse_mass * over.time
    error = error + ((rate + over.velocity + 0.5 * speed) * over.time - over.moved)
    return error, rate + (speed - over.gained)


def predict(p: Covariance, noise: tuple[Number, ...], inverse_mass: Number, over: Interval) -> Covariance:
    """P <- F P F' + Q.

    noise: variances per second of ė; of ė at a reversal, over the square of the speed gained there; per second of d0,
    theta1, theta2 and theta3. The thetas drift only in motion. Where the reference reverses, the plant stops a little
    early or late and friction holds it meanwhile: its speed is uncertain there, and the thetas are not to blame.
    """
    p00, p01, p02, p03, p04, p05, p11, p12, p13, p14, p15, p22, p23, p24, p25, p33, p34, p35, p44, p45, p55 = p
    time, _, gained, before, s, v, a = over
    after = before + gained
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
    # The speed gained where the reference reverses, falling with the distance from it.
    squared = gained * gained
    near = squared * (squared / (before * before + after * after + TINY))
    rate = rate * time + reversal * near
    moving = s * s * time
    return Covariance(
        n00, n01, n02, n03, n04, n05, n11 + rate, n12, n13, n14, n15, p22 + bias * time, p23, p24, p25,
        p33 + coulomb * moving, p34, p35, p44 + viscous * moving, p45, p55 + mass * moving,
    )  # fmt: skip


def update(p: Covariance, measurement: Number, fresh: Number) -> tuple[Covariance, tuple[Number, ...]]:
    """P <- (I - K H) P and K (6), for a position sample of variance `measurement` (m^2); nothing where fresh is 0."""
    p00, p01, p02, p03, p04, p05, p11, p12, p13, p14, p15, p22, p23, p24, p25, p33, p34, p35, p44, p45, p55 = p
    scale = fresh / (p00 + measurement)
    k0, k1, k2, k3, k4, k5 = scale * p00, scale * p01, scale * p02, scale * p03, scale * p04, scale * p05
    return Covariance(
        p00 - k0 * p00, p01 - k0 * p01, p02 - k0 * p02, p03 - k0 * p03, p04 - k0 * p04, p05 - k0 * p05,
        p11 - k1 * p01, p12 - k1 * p02, p13 - k1 * p03, p14 - k1 * p04, p15 - k1 * p05,
        p22 - k2 * p02, p23 - k2 * p03, p24 - k2 * p04, p25 - k2 * p05,
        p33 - k3 * p03, p34 - k3 * p04, p35 - k3 * p05, p44 - k4 * p04, p45 - k4 * p05, p55 - k5 * p05,
    ), (k0, k1, k2, k3, k4, k5)  # fmt: skip
