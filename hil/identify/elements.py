"""Friction as several slip elements: what an axis shows that is no single bristle.

Maxwell-slip (Al-Bender, Lampaert, Swevers, IEEE TAC 50(11), 2005): springs that slip at their limits, all on the same
path. Their lengths are given, so that the force is linear in their limits, which are not negative.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, nnls

from hil.identify.estimate import Array, Estimate, Refused, jackknife
from hil.identify.force_balance import BLOCKS, UNEXPLAINED, Balance, Balanced, Record, balance

A_DECADE = 6  # elements
SHORTEST = 20  # encoder counts; a force that an even shorter one would have is stiffness out of noise
TOLD_SHARE = 1.0 - np.exp(-1.0)  # of friction's turn, at the length of a bristle
# Of Coulomb friction, stiffness and presliding, whose elements have given lengths: share of the value, unit.
SYSTEMATIC = (0.02, "N"), (0.2, "N/m"), (0.15, "m")


class Elements(NamedTuple):
    """lengths: m (rad), and limits: N, of the elements. Their sum, the stiffness after a reversal (N/m), and the length
    at which friction has turned as far as a bristle's at its own. unexplained: share of the force.
    """

    lengths: Array
    limits: Array
    coulomb: Estimate
    stiffness: Estimate
    presliding: Estimate
    unexplained: float


def slipping(path: Array, lengths: Array) -> Array:
    """Force over limit of elements of these lengths along a path, from rest: -1 to 1, (elements, n)."""
    out, now = np.empty((path.size, lengths.size)), np.zeros(lengths.size)
    for i, move in enumerate(np.diff(path, prepend=path[0])[:, None] / lengths):
        now = np.minimum(np.maximum(now + move, -1.0), 1.0)
        out[i] = now
    return out.T


def fit_elements(record: Record, mass: float, viscous: float) -> Elements:
    """The limits that explain the record's force best, with 95 % intervals from a block jackknife. Raises Refused."""
    of = Balanced(record, mass, viscous)
    first, last = SHORTEST * record.resolution, 0.5 * float(np.ptp(of.path))
    if first >= last:
        raise Refused(f"loops of {2.0 * last:.2g} m: the encoder does not resolve their elements")
    lengths = np.geomspace(first, last, max(2, round(A_DECADE * np.log10(last / first)) + 1))
    target = (of.force - viscous * of.velocity - mass * of.acceleration)[of.inside]
    rows = np.array([of.filtered(state) for state in slipping(of.path, lengths)])[:, of.inside]
    columns = np.vstack([rows, np.ones(target.size), -np.ones(target.size)]).T
    limits, left = nnls(columns, target)
    unexplained = float(left / np.sqrt(((target - target.mean()) ** 2).sum()))
    if unexplained > UNEXPLAINED:
        raise Refused(
            f"slip elements leave {100 * unexplained:.0f} % of the force unexplained "
            f"(at most {100 * UNEXPLAINED:.0f} %)"
        )
    without = []
    for block in np.array_split(np.arange(target.size), BLOCKS):
        kept = np.setdiff1d(np.arange(target.size), block)
        without.append(_told(nnls(columns[kept], target[kept])[0][: lengths.size], lengths))
    told, half = _told(limits[: lengths.size], lengths), jackknife(without)
    coulomb, stiffness, length = (
        Estimate(value, float(np.hypot(width, share * value)), unit)
        for value, width, (share, unit) in zip(told.tolist(), half.tolist(), SYSTEMATIC, strict=True)
    )
    return Elements(lengths, limits[: lengths.size], coulomb, stiffness, length, unexplained)


def _told(limits: Array, lengths: Array) -> Array:
    """Coulomb friction, stiffness and presliding of elements with these limits."""
    whole = float(limits.sum())
    if whole <= 0.0:
        raise Refused("no friction in the loops")

    def turned(way: float) -> float:
        return float((limits * np.minimum(way / lengths, 2.0)).sum()) / (2.0 * whole)

    length = brentq(lambda way: turned(way) - TOLD_SHARE, 0.0, 2.0 * lengths[-1])
    return np.array([whole, float((limits / lengths).sum()), length])


def friction_at_rest(
    record: Record, mass: float, viscous: float
) -> tuple[dict[str, Estimate], dict[str, str], Elements | None]:
    """Presliding and stiffness at rest by quantity, and what was refused: of one bristle, with its damping, or of slip
    elements, whichever explains the loops better; with these elements. Raises Refused.
    """
    bristle: Balance | None = None
    elements: Elements | None = None
    why = ""
    try:
        bristle = balance([record], mass, viscous)
    except Refused as refused:
        why = refused.reason
    try:
        elements = fit_elements(record, mass, viscous)
    except Refused as refused:
        why = why or refused.reason
    if elements is not None and (bristle is None or elements.unexplained < bristle.unexplained):
        return {"presliding": elements.presliding, "stiffness": elements.stiffness}, {}, elements
    if bristle is None:
        raise Refused(why)
    if "presliding" not in bristle.found or "coulomb" not in bristle.found:
        return {}, {"presliding": bristle.refused.get("presliding", bristle.refused.get("coulomb", ""))}, None
    length, friction = bristle.found["presliding"], bristle.found["coulomb"]
    share = math.hypot(length.half_width / length.value, friction.half_width / friction.value)
    stiffness = friction.value / length.value
    found = {"presliding": length, "stiffness": Estimate(stiffness, share * stiffness, "N/m")}
    return found | {"bristle_damping": bristle.found["bristle_damping"]}, {}, None
