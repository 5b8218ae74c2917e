"""Gains of presliding-kalman that follow from the model, written for floats and arrays.

Loop and observer in motion hold 6 dB and 30 degrees as the model says, and 3 dB and 15 degrees with mass +-20 % and
mode +-10 % (hil/analysis/loop_corners.py). This goes for any mode from 0.15 swings in a period on. A search kept these
and made the tool's error after a step of force small. The slower the mode, the lower is the one that the observer takes
it for: a mode slower than expected turns the phase that the loop lives on.

Where the axis was measured (`Model.known`) the loop is quicker. It holds 4.5 dB and 30 degrees as the model says, and
3 dB and 15 degrees with mass +-2 %, mode +-2 %, lag +-5 %. Between the two columns lie straight lines, which hold the
same up to twice these shares. The friction weights learn sooner, too, and take a mode that the reference shakes for
less noise: how it swings is known.
"""

from hil.control.laws.base import Model
from hil.control.number import Number, at_least, at_most, full_like, root, select, zeros_like

# Swings of the free axis' mode in a period; straight lines between, and what the outermost have beyond.
SWINGS = (0.15, 0.175, 0.2, 0.3)

# Where the model has no mode; and at SWINGS, or with any mode.
OF_MODE: dict[str, tuple[float, tuple[float, ...]]] = {
    "bandwidth": (0.2228, (0.1549, 0.1549, 0.1488, 0.1669)),
    "damping": (0.4184, (0.4834, 0.5841, 0.549, 0.583)),
    "force_noise": (9.2, (12.5, 7.183, 3.912, 6.426)),
    "disturbance_noise": (6.7, (3.322, 1.798, 1.319, 2.868)),
    "mode_noise": (13.1, (15.31, 12.65, 9.686, 10.96)),
    "mode_share": (1.0, (0.9188, 0.932, 0.9831, 1.0435)),
    "rest_bandwidth": (0.12, (0.05,)),
    "rest_damping": (0.38, (0.8,)),
    "rest_force_noise": (0.83, (3.4,)),
    "rest_disturbance_noise": (0.105, (0.155,)),
    "innovation_noise": (0.06, (0.6,)),
    "integral": (0.1, (0.08,)),
    "table_delay": (6.0, (12.0,)),
    "shaken": (20.0, (20.0,)),
}
# At SWINGS, of an axis that was measured.
OF_KNOWN: dict[str, tuple[float, ...]] = {
    "bandwidth": (0.1931, 0.1955, 0.2098, 0.2331),
    "damping": (0.3627, 0.39, 0.3988, 0.4489),
    "force_noise": (9.15, 3.006, 2.018, 4.767),
    "disturbance_noise": (17.85, 5.664, 4.646, 8.354),
    "mode_noise": (32.55, 8.624, 5.82, 4.176),
    "mode_share": (0.9894, 0.9894, 0.9924, 1.0086),
    "innovation_noise": (0.2,),
    "table_delay": (8.0,),
    "shaken": (5.0,),
}
# Where the model has no mode, but states presliding. A step of 1 um is over sooner, and Z does not ring on stiff
# friction; on friction as in the textbook an axis would swing to and fro by nearly 0.1 mm.
OF_PRESLIDING: dict[str, float] = {"integral": 0.06}


def swings_of(model: Model, period: float) -> Number:
    """Of the free axis' first mode in a period (s); 0: it has none."""
    shape = model.mass
    return full_like(shape, model.mode_frequency) * root(1.0 / (1.0 - full_like(shape, model.mode_load))) * period


def of_model(name: str, swings: Number, presliding: Number, known: Number) -> Number:
    """That gain for a mode of so many swings in a period, the presliding that the model states (0: none), and how well
    it is known: 0 to 1.
    """
    rigid, flexible = OF_MODE[name]
    zero = zeros_like(swings)
    usual = between(flexible, swings)
    value = usual + known * (between(OF_KNOWN.get(name, flexible), swings) - usual)
    guided = select(presliding > 0.0, zero + OF_PRESLIDING.get(name, rigid), zero + rigid)
    return select(swings > 0.0, value, guided)


def between(column: tuple[float, ...], swings: Number) -> Number:
    """On the straight lines between a column's values at SWINGS."""
    value = zeros_like(swings) + column[0]
    for place in range(1, len(column)):
        begin, end = SWINGS[place - 1], SWINGS[place]
        slope = (column[place] - column[place - 1]) / (end - begin)
        value = value + slope * at_most(at_least(swings - begin, 0.0), end - begin)
    return value
