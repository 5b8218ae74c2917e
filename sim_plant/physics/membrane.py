"""A cell's membrane in front of the pipette: point load on a clamped circular membrane at large deflection, F = K w^3.

K and the depth of puncture are assumed values (docs/paper.md), for the rig file to change. The membrane
pushes back until the tip reaches the puncture depth; from then on only drag acts while the tip is inside; once the tip
has left, the next cell's membrane is whole again.
"""

from typing import Any, NamedTuple

Number = Any  # float, or an array; every function maps one kind to the same kind


class Membrane(NamedTuple):
    """Membrane of one axis (floats) or of many (arrays). stiffness = 0 and drag = 0: no cell on this axis.

    surface: m, axis position of first touch. direction: +1.0 or -1.0, sign of the motion into the cell.
    stiffness: N/m^3. puncture_depth: m. drag: N s/m.
    """

    surface: Number
    direction: Number
    stiffness: Number
    puncture_depth: Number
    drag: Number


def depth(membrane: Membrane, position: Number) -> Number:
    """How far (m) the tip is past the untouched surface; negative outside."""
    return (position - membrane.surface) * membrane.direction


def resistance(membrane: Membrane, position: Number, velocity: Number, pierced: Number) -> Number:
    """Force (N) the cell takes from the axis' driving force. pierced: 1.0 or 0.0."""
    inside = depth(membrane, position)
    indentation = 0.5 * (inside + abs(inside))  # max(inside, 0), exactly, for floats and arrays alike
    elastic = membrane.stiffness * indentation * indentation * indentation
    return (1.0 - pierced) * membrane.direction * elastic + pierced * membrane.drag * velocity


def transition(membrane: Membrane, position: Number, pierced: Number) -> Number:
    """Distance (m) to the next change of state along the depth: >= 0 once it is due.

    Whole: depth - puncture_depth. Pierced: -depth, which turns positive when the tip leaves.
    """
    inside = depth(membrane, position)
    return inside - membrane.puncture_depth - pierced * (2.0 * inside - membrane.puncture_depth)
