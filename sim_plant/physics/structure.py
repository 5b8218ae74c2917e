"""What an axis that deviates is made of, and the state it is in."""

from typing import Any, NamedTuple

from sim_plant.physics.number import Number

Lines = Any  # LINES floats, or as many arrays

LINES = 4  # sinusoids of one kind an axis can have


class Structure(NamedTuple):
    """Parameters of one axis (floats; lines: tuples) or of many (arrays (n,); lines: (LINES, n)), SI; absent: zero.

    mass: kg, of both sides. coulomb, stribeck: N. slowness: s/m, 1 / v_s. viscous: N s/m. quadratic: N s^2/m^2.
    presliding: m. bristle_damping: N s/m, s1. lag: s. load: kg, m2. mode_stiffness: N/m. mode_damping: N s/m.
    variation: fraction of the dry friction, a sinusoid of position. cable_stiffness: N/m. cable_hysteresis: N.
    cable_reach: m. backlash: m. line_...: sinusoids of position, N. floor_...: of time, m/s^2. The membrane's: as in
    membrane.py.
    """

    mass: Number
    coulomb: Number
    stribeck: Number
    slowness: Number
    viscous: Number
    quadratic: Number
    presliding: Number
    bristle_damping: Number
    lag: Number
    load: Number
    mode_stiffness: Number
    mode_damping: Number
    variation: Number
    variation_wavenumber: Number
    variation_phase: Number
    cable_stiffness: Number
    cable_hysteresis: Number
    cable_reach: Number
    backlash: Number
    line_amplitude: Lines
    line_wavenumber: Lines
    line_phase: Lines
    floor_amplitude: Lines
    floor_frequency: Lines
    floor_phase: Lines
    surface: Number
    direction: Number
    membrane: Number
    puncture_depth: Number
    drag: Number


class Motion(NamedTuple):
    """State of an axis: the motor's position and velocity, m and m/s; pierced: 1.0 or 0.0; the load's position and
    velocity. bristle: z, m; cable: -1 to 1, of its hysteresis; force: N, f behind the lag; played: m, the load's
    position behind the backlash; walked: N, of the bias.
    """

    position: Number
    velocity: Number
    pierced: Number
    load_position: Number
    load_velocity: Number
    bristle: Number
    cable: Number
    force: Number
    played: Number
    walked: Number


def rigid(motion: Motion, position: Number, velocity: Number, pierced: Number) -> Motion:
    """The motion of an axis whose load is its motor; bristle, cable, force and walk as they were."""
    _, _, _, _, _, bristle, cable, force, _, walked = motion
    return Motion(position, velocity, pierced, position, velocity, bristle, cable, force, position, walked)


def with_walk(motion: Motion, walked: Number) -> Motion:
    """The same motion under a bias that has walked to `walked` (N)."""
    q, v, pierced, y, u, bristle, cable, force, played, _ = motion
    return Motion(q, v, pierced, y, u, bristle, cable, force, played, walked)
