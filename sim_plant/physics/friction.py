"""Set-valued friction on one smooth branch: eq. (2) of the paper with its Delta sgn(v), and a Stribeck peak.

    friction(v) = (coulomb + stribeck / (1 + (v / v_s)^2)) Sgn(v) + viscous v + quadratic v |v|

Sgn(0) is the whole interval [-1, 1]: at rest friction balances any net force up to coulomb + stribeck. The usual
Stribeck shape exp(-(v/v_s)^2) is replaced by the rational 1 / (1 + (v/v_s)^2): it peaks and decays alike, and needs
only operations that IEEE 754 defines to the last bit, so that a run is the same on every machine.

Everything here is written with + - * / alone: the same lines serve floats (one axis) and arrays (many), bit for bit.
"""

from typing import Any, NamedTuple

Number = Any  # float, or an array; every function maps one kind to the same kind


class Friction(NamedTuple):
    """Friction of one axis (floats) or of many (arrays of one shape).

    coulomb: N, constant part (scaled Coulomb, modelling error, brake). stribeck: N, extra at rest.
    stribeck_slowness: s/m, 1 / v_s. viscous: N s/m. quadratic: N s^2/m^2.
    """

    coulomb: Number
    stribeck: Number
    stribeck_slowness: Number
    viscous: Number
    quadratic: Number


def breakaway(friction: Friction) -> Number:
    """Largest net force (N) that leaves an axis at rest."""
    return friction.coulomb + friction.stribeck


def sliding(friction: Friction, velocity: Number, sign: Number) -> Number:
    """Friction force (N, opposing motion) on the branch sgn(v) = sign, continued smoothly through v = 0.

    The continuation is what an integrator needs to step up to the instant of a sign change; sign is +1.0 or -1.0.
    """
    coulomb, stribeck, slowness, viscous, quadratic = friction
    ratio = velocity * slowness
    dry = coulomb + stribeck / (1.0 + ratio * ratio) + quadratic * velocity * velocity
    return sign * dry + viscous * velocity


def sliding_plain(friction: Friction, velocity: Number, sign: Number) -> Number:
    """As `sliding` where stribeck = 0, with the same bits and fewer operations."""
    dry = friction[0] + friction[4] * velocity * velocity
    return sign * dry + friction[3] * velocity
