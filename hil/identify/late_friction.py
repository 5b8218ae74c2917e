"""What friction that falls with speed (Stribeck) does to the mass that a frequency response shows.

At constant speed a bristle's friction follows small changes of speed in proportion to its slope over speed there. Its
damping makes it lead by sigma_1 / sigma_0, and its length makes it lag; out of phase, it acts as a mass does. With the
damping that Canudas de Wit and others take, sigma_1 = sqrt(sigma_0 m) (IEEE TAC 40(3), 1995), that lead is sqrt(mass
presliding / Coulomb friction). Viscous friction is at once there, and acts as no mass.
"""

import math

import numpy as np

from hil.identify.estimate import Array, Estimate

GAIN = 1.5  # by which a falling part must lower what a straight line leaves of friction over speed, squared
TRIED = 40  # speeds at which half of it may be gone, from a tenth of the least measured to the greatest


def viscous_beside(speed: Array, friction: Array) -> float | None:
    """Viscous friction (N s/m) beside one that falls with speed, by friction (N) at these speeds (m/s), (n,) both; None
    where there is no such friction.
    """
    speed = np.abs(speed)
    line = [np.ones(speed.size), speed]
    straight, best, viscous = _left(line, friction)[0], math.inf, 0.0
    for half in np.geomspace(0.1 * speed.min(), speed.max(), TRIED).tolist():
        left, (_, slope, falls) = _left([*line, 1.0 / (1.0 + (speed / half) ** 2)], friction)
        if falls > 0.0 and left < best:
            best, viscous = left, slope
    return viscous if best * GAIN < straight else None


def _left(columns: list[Array], target: Array) -> tuple[float, list[float]]:
    """Squared residual of a least-squares fit, and its coefficients."""
    found, *_ = np.linalg.lstsq(np.array(columns).T, target, rcond=None)
    rest = target - found @ np.array(columns)
    return float(rest @ rest), found.tolist()


def allow_for_late_friction(found: dict[str, Estimate], slope: Estimate, viscous: float) -> None:
    """Wider intervals of the mass and of the parts of it that ring. slope: of friction over speed, by the frequency
    response; viscous: what of it is at once there. Nothing where presliding is not known.
    """
    if "presliding" not in found or "coulomb" not in found:
        return
    mass = found["mass"].value
    late = abs(slope.value - viscous) * math.sqrt(mass * found["presliding"].value / found["coulomb"].value)
    for name, one in found.items():
        if name == "mass" or name.endswith("_load"):
            found[name] = one._replace(half_width=math.hypot(one.half_width, late / mass * one.value))
