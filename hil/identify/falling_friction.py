"""Friction that falls with speed (Stribeck), from passes at several speeds over the same places.

Beside Coulomb and viscous friction there is then a part that is gone at high speed. Nobody knows its shape. The
rational one is Hess and Soom's; the exponential ones are Bo and Pavelescu's and Armstrong-Helouvry's (Automatica 30(7),
1994). All that explain the measured friction count, and the intervals span them.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hil.identify.estimate import Array
from hil.identify.places import Points

WORSE = 2.0  # times the least residual: what still explains the friction, about 95 % with eight speeds
EXACT = 3e-4  # of friction: a smaller residual explains it in any case
SHAPES = 3
SCALES, SLOWEST, FASTEST = 60, 0.1, 0.5  # speeds tried, from this share of the least measured to that of the greatest
UNKNOWNS = 4  # coulomb, viscous, amplitude, scale


class Falling(NamedTuple):
    """shape: number of the falling part; scale: its speed, m/s; amplitude: N, if it held down to rest; least: speed
    from which on it was seen, m/s. viscous: N s/m, what is beside it. coulomb_off, viscous_off: by how much others
    that explain the friction as well differ, N and N s/m; infinite where it may fall on beyond the speeds passed.
    """

    shape: int
    scale: float
    amplitude: float
    least: float
    viscous: float
    coulomb_off: float = 0.0
    viscous_off: float = 0.0

    def at(self, speed: Array) -> Array:
        """Its falling part at these speeds (m/s, either sign), N, (n,); at slower ones than were seen, as there."""
        return self.amplitude * _shape(self.shape, np.maximum(np.abs(speed), self.least) / self.scale)

    def of(self, points: Points, speeds: Sequence[float]) -> "Falling":
        """The same shape and scale for other passes; the same altogether where they have too few speeds."""
        speed, friction = over_speed(points, speeds)
        if speed.size < UNKNOWNS:
            return self
        (_, viscous, amplitude), _ = _fit(speed, friction, self.shape, self.scale)
        return self._replace(viscous=viscous, amplitude=amplitude)


def _shape(number: int, u: Array) -> Array:
    """1 at rest, 0 at high speed."""
    shape: Array = 1.0 / (1.0 + u * u) if number == 0 else np.exp(-(u**number))
    return shape


def falling(points: Points, speeds: Sequence[float]) -> Falling | None:
    """The part of friction that falls with speed; None where a straight line over speed explains the friction, or where
    no more speeds than unknowns were passed both ways. speeds: of each pass, m/s.
    """
    speed, friction = over_speed(points, speeds)
    if speed.size <= UNKNOWNS:
        return None
    tried = [
        (left, coulomb, Falling(shape, scale, amplitude, float(speed.min()), viscous))
        for shape in range(SHAPES)
        for scale in np.geomspace(SLOWEST * speed.min(), FASTEST * speed.max(), SCALES).tolist()
        for (coulomb, viscous, amplitude), left in [_fit(speed, friction, shape, scale)]
        if amplitude > 0.0 and coulomb > 0.0
    ]
    enough = max(WORSE * min([left for left, *_ in tried], default=0.0), EXACT * float(friction.mean()))
    if not tried or _fit(speed, friction)[1] <= enough:
        return None
    explain = [(coulomb, one) for left, coulomb, one in tried if left <= enough]
    coulombs, viscous = np.array([c for c, _ in explain]), np.array([one.viscous for _, one in explain])
    nearest = int(np.argmin(np.abs(coulombs - 0.5 * (coulombs.min() + coulombs.max()))))
    off = [float(np.abs(each - each[nearest]).max()) for each in (coulombs, viscous)]
    if max(one.scale for _, one in explain) > 0.99 * FASTEST * speed.max():
        off = [math.inf, math.inf]  # it may fall on beyond the speeds that were passed
    return explain[nearest][1]._replace(coulomb_off=off[0], viscous_off=off[1])


def over_speed(points: Points, speeds: Sequence[float]) -> tuple[Array, Array]:
    """Speed (m/s) and friction (N) at each speed that was passed both ways, (k,): half the difference of both ways'
    forces, at the places that all passes went over. speeds: of each pass, m/s.
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
            rows.append((np.mean([np.abs(points.velocity[way]).mean() for way in ways]), 0.5 * (forth - back)))
    speed, friction = np.array(rows).reshape(-1, 2).T
    return speed, friction


def _fit(speed: Array, friction: Array, shape: int | None = None, scale: float = 1.0) -> tuple[list[float], float]:
    """Coulomb and viscous friction, and the falling part's amplitude if it has a shape; the RMS force left, N."""
    columns = [np.ones(speed.size), speed]
    if shape is not None:
        columns.append(_shape(shape, speed / scale))
    a = np.array(columns)
    found, *_ = np.linalg.lstsq(a.T, friction, rcond=None)
    return found.tolist(), float(np.sqrt(((friction - found @ a) ** 2).mean()))
