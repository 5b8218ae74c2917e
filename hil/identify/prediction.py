"""The force that an axis needs for a motion, by what was identified of it: held against motions that no fit used."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from hil.identify.elements import Elements, slipping
from hil.identify.estimate import Array, Estimate
from hil.identify.force_balance import LENGTHS, Balanced, Record, bristle
from hil.identify.signals import Signals
from hil.identify.travel_fit import TravelCurves

STALL_TICKS = 301  # about an instant without samples
MOVING = 0.1  # of the motion's greatest speed: at rest the force may be anything within friction


class Unexplained(NamedTuple):
    """Of a motion: s of task time, the force that it took and what of it is left unexplained, N, (n,) each."""

    seconds: Array
    force: Array
    rest: Array

    @property
    def rms(self) -> float:
        """What is left, N."""
        return float(np.sqrt((self.rest**2).mean()))


class AxisForces(NamedTuple):
    """mass: kg, viscous: N s/m, presliding: m, lag: s; travel: friction and force of each place."""

    mass: float
    viscous: float
    presliding: float
    lag: float
    travel: TravelCurves
    elements: Elements | None = None

    @classmethod
    def of(
        cls,
        found: Mapping[str, Estimate],
        travel: TravelCurves,
        mass: float,
        lag: float,
        elements: Elements | None = None,
    ) -> "AxisForces":
        """By what was found; mass and lag are for what was not."""
        told = {name: one.value for name, one in found.items()}
        length = told.get("presliding", float(LENGTHS[0]))
        return cls(told.get("mass", mass), travel.viscous, length, lag, travel, elements)

    def _turned(self, path: Array) -> Array:
        """Friction over Coulomb friction along a path."""
        if self.elements is None:
            return bristle(path, self.presliding)
        limits = self.elements.limits
        turned: Array = limits @ slipping(path, self.elements.lengths) / limits.sum()
        return turned

    def held_against(self, of: Signals) -> "Unexplained":
        """The force that the motion took beyond this, while it moved; stalls of the computer left out."""
        part = Balanced(Record(of.force, of.position, of.period, of.count, self.lag), None, None)
        position = part.filtered(of.position)
        friction = np.interp(position, self.travel.position, self.travel.friction)
        if self.travel.curved:
            friction += self.travel.curved.at(part.velocity)
        place = np.interp(position, self.travel.position, self.travel.place)
        state = part.filtered(self._turned(part.path))
        needed = self.mass * part.acceleration + self.viscous * part.velocity + friction * state + place
        near = np.convolve(of.stalled, np.ones(STALL_TICKS), mode="same") > 0.5
        counts = (np.abs(part.velocity) > MOVING * np.abs(part.velocity).max()) & ~near
        counts[: part.inside.start] = counts[part.inside.stop :] = False
        return Unexplained(of.seconds[counts], part.force[counts], (part.force - needed)[counts])
