"""What friction that falls with speed (Stribeck) does to the mass that a frequency response shows.

At constant speed a bristle's friction follows small changes of speed in proportion to its slope over speed there. Its
damping makes it lead by sigma_1 / sigma_0, and its length makes it lag; out of phase, it acts as a mass does. With the
damping that Canudas de Wit and others take, sigma_1 = sqrt(sigma_0 m) (IEEE TAC 40(3), 1995), that lead is sqrt(mass
presliding / Coulomb friction). Viscous friction is at once there, and acts as no mass.
"""

import math

from hil.identify.estimate import Estimate

LAG_HZ = 100.0  # from about here on such friction no longer follows, and its share of the phase is taken for lag
DAMPING = 2.0  # a resonance's damping is off by at most so many times the share by which the mass is


def allow_for_late_friction(found: dict[str, Estimate], slope: Estimate, viscous: float) -> None:
    """Wider intervals of the mass, of the parts of it that ring, of their damping and of the lag. slope: of friction
    over speed, by the frequency response; viscous: what of it is at once there. Nothing where presliding is not known.
    """
    if "presliding" not in found or "coulomb" not in found:
        return
    mass, falls = found["mass"].value, abs(slope.value - viscous)
    share = falls * math.sqrt(found["presliding"].value / found["coulomb"].value / mass)
    for name, one in found.items():
        off = 0.0
        if name == "mass" or name.endswith("_load"):
            off = share * one.value
        elif name.endswith("_damping") and name != "bristle_damping":
            off = DAMPING * share * one.value
        elif name == "torque_lag":
            off = falls / mass / (2.0 * math.pi * LAG_HZ) ** 2
        if off:
            found[name] = one._replace(half_width=math.hypot(one.half_width, off))
