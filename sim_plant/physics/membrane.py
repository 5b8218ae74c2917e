"""A cell's membrane in front of the pipette: point load on a clamped circular membrane at large deflection, F = K w^3.

K and the depth of puncture are assumed values (docs/paper.md), for the rig file to change. The membrane
pushes back until the tip reaches the puncture depth; from then on only drag acts while the tip is inside; once the tip
has left, the next cell's membrane is whole again.
"""

from sim_plant.physics.number import Number


class Membrane:
    """Membrane of one axis (floats) or of many (arrays). stiffness = 0 and drag = 0: no cell on this axis.

    surface: m, axis position of first touch. direction: +1.0 or -1.0, sign of the motion into the cell.
    stiffness: N/m^3. puncture_depth: m. drag: N s/m.
    """

    def __init__(
        self, surface: Number, direction: Number, stiffness: Number, puncture_depth: Number, drag: Number
    ) -> None:
        self.surface: Number = surface
        self.direction: Number = direction
        self.stiffness: Number = stiffness
        self.puncture_depth: Number = puncture_depth
        self.drag: Number = drag

    def resistance(self, position: Number, velocity: Number, pierced: Number) -> Number:
        """Force (N) the cell takes from the axis' driving force. pierced: 1.0 or 0.0."""
        inside = (position - self.surface) * self.direction
        indentation = 0.5 * (inside + abs(inside))  # max(inside, 0), exactly, for floats and arrays alike
        elastic = self.stiffness * indentation * indentation * indentation
        return (1.0 - pierced) * self.direction * elastic + pierced * self.drag * velocity

    def transition(self, position: Number, pierced: Number) -> Number:
        """Distance (m) to the next change of state along the depth: >= 0 once it is due.

        Whole: depth - puncture_depth. Pierced: -depth, which turns positive when the tip leaves.
        """
        inside = (position - self.surface) * self.direction
        return inside - self.puncture_depth - pierced * (2.0 * inside - self.puncture_depth)
