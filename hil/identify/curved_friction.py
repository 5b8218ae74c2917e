"""Friction that is no straight line over speed, from passes at several speeds over the same places.

Beside Coulomb and viscous friction there is then a part that is gone at high speed (Stribeck), one that grows and
flattens, or drag with the square of speed. Nobody knows the shape of the first two. The rational one is Hess and
Soom's; the exponential ones are Bo and Pavelescu's and Armstrong-Helouvry's (Automatica 30(7), 1994). All that explain
the measured friction count, and the intervals span them. Drag has one unknown less, so it is taken alone where it
explains friction clearly better than all of them.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hil.identify.estimate import Array
from hil.identify.places import Points

WORSE = 2.0  # times the least residual, or the noise: what still explains the friction, about 95 % with eight speeds
EXACT = 3e-4  # of friction: a smaller residual explains it in any case
SHAPES = 3
DRAG = SHAPES  # number of the shape with the square of speed
SCALES, SLOWEST, FASTEST = 60, 0.1, 0.5  # speeds tried, from this share of the least measured to that of the greatest
UNKNOWNS = 4  # coulomb, viscous, amplitude, scale


class Curved(NamedTuple):
    """shape: number of the curved part; scale: its speed, m/s; amplitude: N, of one that falls to 0 if it held down to
    rest, negative where friction grows; of drag the force at the scale. least: speed from which on it was seen, m/s.
    viscous: N s/m, what is beside it. coulomb_off, viscous_off: by how much others that explain the friction as well
    differ, N and N s/m; infinite where it grows and flattens, or may fall on beyond the speeds passed.
    """

    shape: int
    scale: float
    amplitude: float
    least: float
    viscous: float
    coulomb_off: float = 0.0
    viscous_off: float = 0.0

    @property
    def drag(self) -> float:
        """With the square of speed, N s^2/m^2; 0 where the part has another shape."""
        return self.amplitude / self.scale**2 if self.shape == DRAG else 0.0

    @property
    def words(self) -> str:
        """What friction does."""
        if self.shape == DRAG:
            return "is no straight line over speed"
        return "falls with speed" if self.amplitude > 0.0 else "grows with speed and flattens"

    def at(self, speed: Array) -> Array:
        """Its curved part at these speeds (m/s, either sign), N, (n,); at slower ones than were seen, as there."""
        return self.amplitude * _shape(self.shape, np.maximum(np.abs(speed), self.least) / self.scale)

    def of(self, points: Points, speeds: Sequence[float]) -> "Curved":
        """The same shape and scale for other passes; the same altogether where they have too few speeds."""
        speed, friction, _ = over_speed(points, speeds)
        if speed.size < UNKNOWNS:
            return self
        (_, viscous, amplitude), _ = _fit(speed, friction, self.shape, self.scale)
        return self._replace(viscous=viscous, amplitude=amplitude)


class Line(NamedTuple):
    """A straight line explains the friction. coulomb_off, viscous_off: by how much drag, which explains it as well,
    would move what the line tells, N and N s/m.
    """

    coulomb_off: float = 0.0
    viscous_off: float = 0.0


def _shape(number: int, u: Array) -> Array:
    """1 at rest, 0 at high speed; of drag the square."""
    if number == DRAG:
        return u * u
    shape: Array = 1.0 / (1.0 + u * u) if number == 0 else np.exp(-(u**number))
    return shape


def curved(points: Points, speeds: Sequence[float]) -> Curved | Line:
    """The part of friction that no straight line over speed explains; a Line where one does, or where no more speeds
    than unknowns were passed both ways. speeds: of each pass, m/s.
    """
    speed, friction, noise = over_speed(points, speeds)
    if speed.size <= UNKNOWNS:
        return Line()
    least, most = float(speed.min()), float(speed.max())
    tried = [
        (left, coulomb, Curved(shape, scale, amplitude, least, viscous))
        for shape in range(SHAPES)
        for scale in np.geomspace(SLOWEST * least, FASTEST * most, SCALES).tolist()
        for (coulomb, viscous, amplitude), left in [_fit(speed, friction, shape, scale)]
        if coulomb > 0.0
    ]
    (coulomb, viscous, amplitude), dragged = _fit(speed, friction, DRAG, most)
    drag = Curved(DRAG, most, amplitude, least, viscous)
    best = min([left for left, *_ in tried], default=math.inf)
    enough = max(WORSE * min(best, dragged), EXACT * float(friction.mean()), WORSE * noise)
    (level, slope), left = _fit(speed, friction)
    if left <= enough:
        return Line(abs(coulomb - level), abs(viscous - slope))
    if WORSE * dragged < best:
        return drag
    explain = [(coulomb, drag)] if dragged <= enough else []
    explain += [(coulomb, one) for left, coulomb, one in tried if left <= enough]
    coulombs, slopes = np.array([c for c, _ in explain]), np.array([one.viscous for _, one in explain])
    nearest = int(np.argmin(np.abs(coulombs - 0.5 * (coulombs.min() + coulombs.max()))))
    off = [float(np.abs(each - each[nearest]).max()) for each in (coulombs, slopes)]
    others = [one for _, one in explain if one.shape != DRAG]
    if any(one.amplitude < 0.0 or one.scale > 0.99 * FASTEST * most for one in others):
        off = [math.inf, math.inf]  # nobody knows what it does at rest, or beyond the speeds that were passed
    return explain[nearest][1]._replace(coulomb_off=off[0], viscous_off=off[1])


def over_speed(points: Points, speeds: Sequence[float]) -> tuple[Array, Array, float]:
    """Speed (m/s) and friction (N) at each speed that was passed both ways, (k,): half the difference of both ways'
    forces, at the places that all passes went over. speeds: of each pass, m/s. Besides the noise of friction, N: half
    the sum of both ways' forces has the same, and no speed is in it.
    """
    up = points.velocity > 0.0
    count = np.array([np.unique(points.of_pass[way]).size for way in (~up, up)])
    group = 2 * points.place.astype(int) + up
    shared = np.bincount(group)[group] == count[up.astype(int)]
    size = np.abs(np.array(speeds))
    kinds = np.unique(np.round(size / size.max(), 4), return_inverse=True)[1][points.of_pass.astype(int)]
    rows = []
    for kind in np.unique(kinds):
        ways = [shared & (kinds == kind) & way for way in (up, ~up)]
        if all(way.any() for way in ways):
            forth, back = (points.force[way].mean() for way in ways)
            speed = np.mean([np.abs(points.velocity[way]).mean() for way in ways])
            rows.append((speed, 0.5 * (forth - back), 0.5 * (forth + back)))
    measured, friction, place = np.array(rows).reshape(-1, 3).T
    return measured, friction, float(np.std(place, ddof=1)) if len(rows) > 1 else 0.0


def _fit(speed: Array, friction: Array, shape: int | None = None, scale: float = 1.0) -> tuple[list[float], float]:
    """Coulomb and viscous friction, and the curved part's amplitude if it has a shape; the RMS force left, N."""
    columns = [np.ones(speed.size), speed]
    if shape is not None:
        columns.append(_shape(shape, speed / scale))
    a = np.array(columns)
    found, *_ = np.linalg.lstsq(a.T, friction, rcond=None)
    return found.tolist(), float(np.sqrt(((friction - found @ a) ** 2).mean()))
