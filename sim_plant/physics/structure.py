"""What an axis that deviates is made of, and the state it is in."""

from typing import Any, NamedTuple

from sim_plant.physics.number import Number

Lines = Any  # LINES floats, or as many arrays

LINES = 4  # sinusoids of one kind an axis can have
HUNG = 2  # masses on springs of their own that hang on a motor beside the tool's
SLIPS = 4  # Maxwell-slip elements an axis can have


class Structure(NamedTuple):
    """Parameters of one axis (floats; lines, hung and slip: tuples) or of many (arrays (n,); lines: (LINES, n),
    hung: (HUNG, n), slip: (SLIPS, n)), SI; absent: zero.

    mass: kg, of all that moves. coulomb, stribeck: N. slowness: s/m, 1 / v_s. viscous: N s/m. quadratic: N s^2/m^2.
    presliding: m. bristle_damping: N s/m, s1. lag: s. load: kg, m2. mode_stiffness: N/m. mode_damping: N s/m.
    variation: fraction of the dry friction, a sinusoid of position. cable_stiffness: N/m. cable_hysteresis: N.
    cable_reach: m. backlash: m. hung_...: of other masses on the motor, as load and the mode's. slip_weight: parts of
    the stiffness at rest. slip_reach: lengths at which elements slip, in lengths of presliding. line_...: sinusoids of
    position, N. floor_...: of time, m/s^2. The membrane's: as in membrane.py.
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
    hung_mass: Lines
    hung_stiffness: Lines
    hung_damping: Lines
    slip_weight: Lines
    slip_reach: Lines
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
    velocity. bristle: z, m. cable: -1 to 1, of its hysteresis. force: N, f behind the lag. played: m, the load's
    position behind the backlash. walked: N, of the bias. second_..., third_...: of the masses hung on the motor beside
    the load. A mass that there is not is where the motor is. slip0 to slip3: m, by which each element is bent.
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
    second_position: Number
    second_velocity: Number
    third_position: Number
    third_velocity: Number
    slip0: Number
    slip1: Number
    slip2: Number
    slip3: Number


def rigid(motion: Motion, position: Number, velocity: Number, pierced: Number) -> Motion:
    """The motion of an axis whose load is its motor; bristle, cable, force and walk as they were."""
    q, v, m = position, velocity, motion
    slips = m.slip0, m.slip1, m.slip2, m.slip3
    return Motion(q, v, pierced, q, v, m.bristle, m.cable, m.force, q, m.walked, q, v, q, v, *slips)


def with_walk(motion: Motion, walked: Number) -> Motion:
    """The same motion under a bias that has walked to `walked` (N)."""
    q, v, pierced, y, u, bristle, cable, force, played, _, p2, w2, p3, w3, a, b, c, d = motion
    return Motion(q, v, pierced, y, u, bristle, cable, force, played, walked, p2, w2, p3, w3, a, b, c, d)
