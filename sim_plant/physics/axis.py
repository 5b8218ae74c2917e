"""Equation of motion of one axis, eq. (2) of the paper row by row, and its integration under a constant force.

    m a = force + gravity - friction(v) + A sin(2 pi q / P) - membrane(q, v)

Written once with + - * / for floats and for arrays: a batch of axes and a single one agree bit for bit.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from sim_plant.physics.exact_trigonometry import TURN, sin_turns, sin_turns_array
from sim_plant.physics.friction import Friction, breakaway, sliding, sliding_plain
from sim_plant.physics.membrane import Membrane, resistance, transition

Number = Any  # float, or an array; every function maps one kind to the same kind

ACCURACY = 0.04  # largest product of rate and step; the Runge-Kutta error per step is its fifth power over 120
RIPPLE_WEIGHT = 0.5  # of a ripple's phase, and of the way through a Stribeck peak: measured to stay below 1 nm
STRIBECK_WEIGHT = 0.5
MAX_SUBSTEPS = 4096
MAX_EVENTS = 8  # of one substep; more cannot happen under a constant force
MAX_ITERATIONS = 60
NO_CELL = Membrane(0.0, 1.0, 0.0, 1e100, 0.0)


class Axis(NamedTuple):
    """Parameters of one axis (floats) or of many (arrays of one shape).

    inverse_mass: 1/kg. ripple_amplitude: N. ripple_wavenumber: turns/m. sine: of turns, for this kind of number.
    has_ripple, has_cell, has_stribeck: whether any axis has one; the terms of the others are zero and leave every bit
    as it was. rate: 1/s, fastest rate at rest. speed_rate: 1/m, additional rate per unit of speed.
    """

    inverse_mass: Number
    friction: Friction
    ripple_amplitude: Number
    ripple_wavenumber: Number
    membrane: Membrane
    sine: Callable[[Number], Number]
    has_stribeck: bool
    has_ripple: bool
    has_cell: bool
    rate: Number
    speed_rate: Number


class State(NamedTuple):
    """Position (m), velocity (m/s), and whether the cell is pierced (1.0 or 0.0)."""

    position: Number
    velocity: Number
    pierced: Number


def make_axis(
    mass: Number,
    friction: Friction,
    ripple_amplitude: Number = 0.0,
    ripple_period: Number = 1.0,
    membrane: Membrane = NO_CELL,
) -> Axis:
    """Axis with its derived rates; mass in kg, ripple_period in m."""
    inverse_mass = 1.0 / mass
    wavenumber = 1.0 / ripple_period
    ripple_rate = np.sqrt(ripple_amplitude * wavenumber * TURN * inverse_mass)
    membrane_rate = np.sqrt(3.0 * membrane.stiffness * membrane.puncture_depth**2 * inverse_mass) * (
        membrane.stiffness > 0
    )
    rate = (abs(friction.viscous) + membrane.drag) * inverse_mass + ripple_rate + membrane_rate
    speed_rate = 2.0 * abs(friction.quadratic) * inverse_mass + RIPPLE_WEIGHT * TURN * wavenumber * (
        ripple_amplitude != 0.0
    )
    return Axis(
        inverse_mass=inverse_mass,
        friction=friction,
        ripple_amplitude=ripple_amplitude,
        ripple_wavenumber=wavenumber,
        membrane=membrane,
        sine=sin_turns_array if isinstance(inverse_mass, np.ndarray) else sin_turns,
        has_stribeck=bool(np.any(friction.stribeck)),
        has_ripple=bool(np.any(ripple_amplitude)),
        has_cell=bool(np.any(membrane.stiffness)) or bool(np.any(membrane.drag)),
        rate=rate,
        speed_rate=speed_rate,
    )


def take(axis: Axis, index: Any) -> Axis:
    """The axes at `index` (an integer: one axis, of floats; an index array: a smaller batch)."""

    def pick(value: Any) -> Any:
        if isinstance(value, tuple):
            return type(value)(*(pick(item) for item in value))
        if isinstance(value, np.ndarray):
            return float(value[index]) if isinstance(index, int) else value[index]
        return value

    return pick(axis)  # type: ignore[no-any-return]


def net_force(axis: Axis, position: Number, velocity: Number, pierced: Number, drive: Number) -> Number:
    """All forces (N) but friction; `drive` is the actuator's force plus gravity (N)."""
    force = drive
    if axis.has_ripple:
        force = force + axis.ripple_amplitude * axis.sine(position * axis.ripple_wavenumber)
    if axis.has_cell:
        force = force - resistance(axis.membrane, position, velocity, pierced)
    return force


def acceleration(
    axis: Axis, position: Number, velocity: Number, pierced: Number, drive: Number, sign: Number
) -> Number:
    """Acceleration (m/s^2) on the branch sgn(v) = sign."""
    force = drive
    if axis.has_ripple:  # net_force, without the call
        force = force + axis.ripple_amplitude * axis.sine(position * axis.ripple_wavenumber)
    if axis.has_cell:
        force = force - resistance(axis.membrane, position, velocity, pierced)
    friction = sliding if axis.has_stribeck else sliding_plain
    return (force - friction(axis.friction, velocity, sign)) * axis.inverse_mass


def runge_kutta(axis: Axis, state: State, drive: Number, sign: Number, h: float) -> tuple[Number, Number]:
    """Position and velocity after h seconds on the branch sgn(v) = sign: the classical fourth-order step."""
    position, velocity, pierced = state
    half = 0.5 * h
    if not (axis.has_stribeck or axis.has_ripple or axis.has_cell):
        # The common case: no term depends on position; the same operations without the calls.
        coulomb, _, _, viscous, quadratic = axis.friction
        inverse_mass = axis.inverse_mass
        a1 = (drive - (sign * (coulomb + quadratic * velocity * velocity) + viscous * velocity)) * inverse_mass
        v2 = velocity + half * a1
        a2 = (drive - (sign * (coulomb + quadratic * v2 * v2) + viscous * v2)) * inverse_mass
        v3 = velocity + half * a2
        a3 = (drive - (sign * (coulomb + quadratic * v3 * v3) + viscous * v3)) * inverse_mass
        v4 = velocity + h * a3
        a4 = (drive - (sign * (coulomb + quadratic * v4 * v4) + viscous * v4)) * inverse_mass
    else:
        a1 = acceleration(axis, position, velocity, pierced, drive, sign)
        v2 = velocity + half * a1
        a2 = acceleration(axis, position + half * velocity, v2, pierced, drive, sign)
        v3 = velocity + half * a2
        a3 = acceleration(axis, position + half * v2, v3, pierced, drive, sign)
        v4 = velocity + h * a3
        a4 = acceleration(axis, position + h * v3, v4, pierced, drive, sign)
    sixth = h * (1.0 / 6.0)
    return (
        position + sixth * (velocity + 2.0 * (v2 + v3) + v4),
        velocity + sixth * (a1 + 2.0 * (a2 + a3) + a4),
    )


def effort(axis: Axis, velocity: Number, drive: Number, h: float) -> Number:
    """Product of h and the fastest rate met during h seconds; about ACCURACY times the substeps it takes."""
    speed = abs(velocity)
    work = h * (axis.rate + speed * axis.speed_rate)
    if axis.has_stribeck:
        # The peak at v = 0 is v_s wide: resolve the change of speed against the distance from it.
        sign = 2.0 * (velocity >= 0.0) - 1.0
        friction = axis.friction
        reach = h * (abs(drive - sign * friction.coulomb) + friction.stribeck) * axis.inverse_mass
        nearest = speed - reach
        nearest = 0.5 * (nearest + abs(nearest))
        slowness = friction.stribeck_slowness * (friction.stribeck > 0)
        work = work + STRIBECK_WEIGHT * (reach * slowness / (1.0 + nearest * slowness))
    return work


def breakaway_sign(axis: Axis, state: State, drive: float) -> float:
    """Direction in which an axis at rest starts to slide; 0.0: friction holds it."""
    net = net_force(axis, *state, drive)
    hold = breakaway(axis.friction)
    if net > hold:
        return 1.0
    return -1.0 if net < -hold else 0.0


def _root(
    axis: Axis, state: State, drive: float, sign: float, h: float, guess: float, stop: bool
) -> tuple[float, float, float]:
    """(time, position, velocity) of the event within (0, h]: velocity zero (stop), or the membrane's transition.

    Newton's method, kept inside a bracket by bisection; the function is the Runge-Kutta step itself as a function of
    its length.
    """
    low, high, tau = 0.0, h, guess
    position, velocity = state.position, state.velocity
    for _ in range(MAX_ITERATIONS):
        position, velocity = runge_kutta(axis, state, drive, sign, tau)
        if stop:
            value = -sign * velocity
            slope = -sign * acceleration(axis, position, velocity, state.pierced, drive, sign)
        else:
            value = transition(axis.membrane, position, state.pierced)
            slope = axis.membrane.direction * velocity * (1.0 - 2.0 * state.pierced)
        low, high = (low, tau) if value > 0.0 else (tau, high)
        following = tau - value / slope if slope > 0.0 else 0.5 * (low + high)
        if abs(following - tau) <= 1e-15 * h:
            break
        tau = following if low < following < high else 0.5 * (low + high)
    return tau, position, velocity


def advance_piece(axis: Axis, state: State, drive: float, h: float) -> State:
    """One axis after h seconds (one substep) of constant force, through every stop, breakaway and puncture."""
    remaining = h
    for _ in range(MAX_EVENTS):
        velocity = state.velocity
        sign = 1.0 if velocity > 0.0 else -1.0 if velocity < 0.0 else breakaway_sign(axis, state, drive)
        if sign == 0.0:
            return state
        position, end = runge_kutta(axis, state, drive, sign, remaining)
        stops = end * sign <= 0.0
        if not stops and not (axis.has_cell and transition(axis.membrane, position, state.pierced) >= 0.0):
            return State(position, end, state.pierced)
        if stops and velocity == 0.0:
            return state  # net force and friction differ by less than rounding: it stays
        tau, pierced = remaining, state.pierced
        if stops:
            guess = remaining * velocity / (velocity - end)
            tau, position, _ = _root(axis, state, drive, sign, remaining, guess, stop=True)
            end = 0.0
        if axis.has_cell and transition(axis.membrane, position, pierced) >= 0.0:
            tau, position, end = _root(axis, state, drive, sign, tau, 0.5 * tau, stop=False)
            pierced = 1.0 - pierced
        state = State(position, end, pierced)
        remaining -= tau
        if remaining <= 0.0:
            break
    return state
