"""Equation of motion of an ideal axis, eq. (2) of the paper row by row, and one step of it under a constant force.

    m a = force + gravity - friction(v) + A sin(2 pi q / P) - membrane(q, v)

Friction is set-valued: its Delta sgn(v) of eq. (2), and a Stribeck peak.

    friction(v) = (coulomb + stribeck / (1 + (v / v_s)^2)) Sgn(v) + viscous v + quadratic v |v|

Sgn(0) is the whole interval [-1, 1]: at rest friction balances any net force up to coulomb + stribeck. A step lies on
one smooth branch, sgn(v) = sign, continued through v = 0, which is what locates the instant of a stop
(single_axis.py). The usual Stribeck shape exp(-(v/v_s)^2) is replaced by the rational 1 / (1 + (v/v_s)^2). It peaks
and decays alike, and needs only operations that IEEE 754 defines to the last bit. So a run is the same on every
machine.

One source for floats and arrays (number.py).
"""

from typing import Final, NamedTuple

from sim_plant.physics.exact_trigonometry import TURN
from sim_plant.physics.membrane import Membrane
from sim_plant.physics.number import Number, anywhere, root, select, sine

ACCURACY: Final = 0.04  # largest product of rate and step; the Runge-Kutta error per step is its fifth power over 120
RIPPLE_WEIGHT: Final = 0.5  # of a ripple's phase, and of the way through a Stribeck peak: measured to stay below 1 nm
STRIBECK_WEIGHT: Final = 0.5
MAX_SUBSTEPS: Final = 4096


class AxisValues(NamedTuple):
    """What one axis is made of (floats), or many (arrays of one shape).

    mass: kg. coulomb: N, constant part (scaled Coulomb, modelling error, brake). stribeck: N, extra at rest. slowness:
    s/m, 1 / v_s. viscous: N s/m. quadratic: N s^2/m^2. ripple_amplitude: N. ripple_wavenumber: turns/m. The others: of
    the membrane (membrane.py).
    """

    mass: Number
    coulomb: Number
    stribeck: Number
    slowness: Number
    viscous: Number
    quadratic: Number
    ripple_amplitude: Number
    ripple_wavenumber: Number
    surface: Number
    direction: Number
    stiffness: Number
    puncture_depth: Number
    drag: Number


class State(NamedTuple):
    """Position (m), velocity (m/s), and whether the cell is pierced (1.0 or 0.0)."""

    position: Number
    velocity: Number
    pierced: Number


class Axis:
    """One axis (floats), or many (arrays).

    has_ripple, has_cell, has_stribeck: whether any axis has one; the terms of the others are zero and leave every bit
    as it was. hold: N, the largest net force that leaves an axis at rest.
    """

    def __init__(self, values: AxisValues) -> None:
        v = values
        self.values = values
        self.has_stribeck = anywhere(v.stribeck != 0.0)
        self.has_ripple = anywhere(v.ripple_amplitude != 0.0)
        self.has_cell = anywhere(v.stiffness != 0.0) or anywhere(v.drag != 0.0)
        self.membrane = Membrane(v.surface, v.direction, v.stiffness, v.puncture_depth, v.drag)
        self.hold: Number = v.coulomb + v.stribeck
        self._coulomb: Number = v.coulomb
        self._stribeck: Number = v.stribeck
        self._slowness: Number = v.slowness * (v.stribeck > 0.0)
        self._viscous: Number = v.viscous
        self._quadratic: Number = v.quadratic
        self._inverse_mass: Number = 1.0 / v.mass
        self._amplitude: Number = v.ripple_amplitude
        self._wavenumber: Number = v.ripple_wavenumber
        ripple_rate = root(v.ripple_amplitude * v.ripple_wavenumber * TURN * self._inverse_mass)
        membrane_rate = root(3.0 * v.stiffness * (v.puncture_depth * v.puncture_depth) * self._inverse_mass)
        # 1/s, the fastest rate at rest, and 1/m, what it grows by per unit of speed
        self._rate: Number = (abs(v.viscous) + v.drag) * self._inverse_mass + ripple_rate + membrane_rate
        ripple_per_metre = RIPPLE_WEIGHT * TURN * v.ripple_wavenumber * (v.ripple_amplitude != 0.0)
        self._speed_rate: Number = 2.0 * abs(v.quadratic) * self._inverse_mass + ripple_per_metre

    def net_force(self, position: Number, velocity: Number, pierced: Number, drive: Number) -> Number:
        """All forces (N) but friction; `drive` is the actuator's force plus gravity (N)."""
        force = drive
        if self.has_ripple:
            force = force + self._amplitude * sine(position * self._wavenumber)
        if self.has_cell:
            force = force - self.membrane.resistance(position, velocity, pierced)
        return force

    def acceleration(self, position: Number, velocity: Number, pierced: Number, drive: Number, sign: Number) -> Number:
        """m/s^2, on the branch sgn(v) = sign: +1.0 or -1.0."""
        force = self.net_force(position, velocity, pierced, drive)
        dry = self._coulomb
        if self.has_stribeck:
            ratio = velocity * self._slowness
            dry = dry + self._stribeck / (1.0 + ratio * ratio)
        dry = dry + self._quadratic * velocity * velocity
        return (force - (sign * dry + self._viscous * velocity)) * self._inverse_mass

    def step(
        self, position: Number, velocity: Number, pierced: Number, drive: Number, sign: Number, h: float
    ) -> tuple[Number, Number]:
        """Position and velocity after h seconds on the branch sgn(v) = sign: the classical fourth-order step."""
        half = 0.5 * h
        if self.has_stribeck or self.has_ripple or self.has_cell:
            a1 = self.acceleration(position, velocity, pierced, drive, sign)
            v2 = velocity + half * a1
            a2 = self.acceleration(position + half * velocity, v2, pierced, drive, sign)
            v3 = velocity + half * a2
            a3 = self.acceleration(position + half * v2, v3, pierced, drive, sign)
            v4 = velocity + h * a3
            a4 = self.acceleration(position + h * v3, v4, pierced, drive, sign)
        else:  # the common case, without the calls: nothing depends on the position
            coulomb, viscous, quadratic = self._coulomb, self._viscous, self._quadratic
            inverse_mass = self._inverse_mass
            a1 = (drive - (sign * (coulomb + quadratic * velocity * velocity) + viscous * velocity)) * inverse_mass
            v2 = velocity + half * a1
            a2 = (drive - (sign * (coulomb + quadratic * v2 * v2) + viscous * v2)) * inverse_mass
            v3 = velocity + half * a2
            a3 = (drive - (sign * (coulomb + quadratic * v3 * v3) + viscous * v3)) * inverse_mass
            v4 = velocity + h * a3
            a4 = (drive - (sign * (coulomb + quadratic * v4 * v4) + viscous * v4)) * inverse_mass
        sixth = h * (1.0 / 6.0)
        return (
            position + sixth * (velocity + 2.0 * (v2 + v3) + v4),
            velocity + sixth * (a1 + 2.0 * (a2 + a3) + a4),
        )

    def effort(self, velocity: Number, drive: Number, h: float) -> Number:
        """Product of h and the fastest rate met during h seconds; about ACCURACY times the substeps it takes."""
        speed = abs(velocity)
        work = h * (self._rate + speed * self._speed_rate)
        if self.has_stribeck:
            # The peak at v = 0 is v_s wide: resolve the change of speed against the distance from it.
            dry = select(velocity >= 0.0, self._coulomb, -self._coulomb)
            reach = h * (abs(drive - dry) + self._stribeck) * self._inverse_mass
            nearest = speed - reach
            nearest = 0.5 * (nearest + abs(nearest))
            work = work + STRIBECK_WEIGHT * (reach * self._slowness / (1.0 + nearest * self._slowness))
        return work
