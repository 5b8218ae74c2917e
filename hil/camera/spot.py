"""The spot around the tip: dark where the cell is dented, bright where a bolus is."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from hil.camera.pipette import Pipette

Plane = NDArray[np.float64]

_AWAY: Final = np.radians(np.arange(45.0, 316.0, 3.0))  # from the pipette's direction
_RADII: Final = np.arange(0.0, 160.0)
_DISCS: Final = np.arange(3.0, 60.0, 0.5)  # radii tried, px
_DENTS: Final = np.geomspace(4.0, 150.0, 60)
_LEAST: Final = 0.03  # of the image's mean: the contrast of a spot
_LEAST_GAIN: Final = 0.6  # of the spread of the rings' brightness, that it must explain


def around(image: Plane, pipette: Pipette) -> tuple[float | None, float | None]:
    """Dimple (px: where its darkness is half that at the tip) and bolus (px^2). 0: there is none; None: not seen."""
    first = 3.0 + 2.0 * pipette.blur
    radii = _RADII[np.searchsorted(_RADII, first, side="right") :]
    rows = pipette.tip.row + radii[:, None] * np.sin(pipette.along + _AWAY)
    columns = pipette.tip.column + radii[:, None] * np.cos(pipette.along + _AWAY)
    rings = map_coordinates(image, (rows, columns), order=1, cval=np.nan)
    whole = np.isfinite(rings).all(axis=1)
    if whole.sum() < 30:
        return None, None
    radii, level = radii[whole], np.median(rings[whole], axis=1)
    sloping = np.vstack([np.ones(radii.size), radii])  # the light is uneven
    disc, bright, explained = _fitted(level, np.clip(0.5 + (_DISCS[:, None] - radii) / 3.0, 0.0, 1.0), sloping)
    if bright > _LEAST and explained > _LEAST_GAIN:
        return 0.0, math.pi * float(_DISCS[disc]) ** 2
    dent, dark, explained = _fitted(level, np.exp2(-((radii / _DENTS[:, None]) ** 2)), sloping[:1])
    return float(_DENTS[dent]) if dark < -_LEAST and explained > _LEAST_GAIN else 0.0, 0.0


def _fitted(level: Plane, models: Plane, floor: Plane) -> tuple[int, float, float]:
    """Which model fits best above a floor of some shape: place, height, share of the squares it explains."""
    base = np.linalg.qr(floor.T)[0]
    models, rest = models - models @ base @ base.T, level - base @ (base.T @ level)
    power = np.maximum((models**2).sum(axis=1), 1e-12)
    height = models @ rest / power
    best = int((height**2 * power).argmax())
    return best, float(height[best]), float(height[best] ** 2 * power[best] / max(float(rest @ rest), 1e-12))
