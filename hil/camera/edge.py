"""Fits the edge at the pipette's end: two levels, a normal distribution between them, and a bright disc around it."""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

Plane = NDArray[np.float64]

STEP: Final = 0.5  # px between the places of a profile
_ENDS: Final = np.arange(-10.0, 10.25, 0.25)  # px, tried around the rough end
_BLURS: Final = np.geomspace(0.7, 9.0, 14)  # px, tried
_DISCS: Final = 7.0, 9.0, 12.0, 16.0, 20.0  # px, radii tried of a bolus
_PASSES: Final = 0.6  # of the light through the pipette
_WORTH: Final = 0.2  # of what the edge alone leaves: a disc explains that much, or there is none


class Edge(NamedTuple):
    """end: px along the profile. blur: px. height: between the levels. left: root mean square of what is not
    explained.
    """

    end: float
    blur: float
    height: float
    left: float


class EdgeFit:
    """Of profiles over `places`, px, -reach to reach: how much darker a band is than what is beside it.

    band, beside: px across, where these were sampled. discs: a bolus may be around the end.
    """

    def __init__(self, reach: float, band: Plane, beside: Plane, *, discs: bool) -> None:
        self.places = np.arange(-reach, reach + STEP / 2.0, STEP)
        behind = self.places - _ENDS[:, None]  # (ends, places)
        models = ndtr(behind[:, None, :] / _BLURS[:, None])  # (ends, blurs, places)
        self._models = models - models.mean(axis=2, keepdims=True)
        self._power = (self._models**2).sum(axis=2)
        self._bumps = []
        for radius in _DISCS if discs else ():
            bump = _disc(radius, behind, beside) - _disc(radius, behind, band)
            bump *= np.where(behind > 0.0, _PASSES, 1.0)
            bump -= bump.mean(axis=1, keepdims=True)
            bump /= np.maximum(np.linalg.norm(bump, axis=1, keepdims=True), 1e-9)  # 0 where none of it is in the window
            models = self._models - (self._models * bump[:, None]).sum(axis=2, keepdims=True) * bump[:, None]
            self._bumps.append((bump, models, (models**2).sum(axis=2)))

    def fit(self, profile: Plane) -> Edge:
        """The best of all tried, the end between two of them by a parabola."""
        level = profile - profile.mean()
        whole = float(level @ level)
        product = self._models @ level
        gain = np.where(product > 0.0, product**2 / self._power, 0.0)  # of the sum of squares
        height = product / self._power
        best = float(gain.max())
        for bump, models, power in self._bumps:
            bright = np.maximum(bump @ level, 0.0)[:, None]
            product = models @ level
            with_disc = np.where((product > 0.0) & (bright > 0.0), product**2 / power + bright**2, 0.0)
            if float(with_disc.max()) > max(best, float(gain.max()) + _WORTH * (whole - float(gain.max()))):
                best, gain, height = float(with_disc.max()), with_disc, product / power
        end, blur = (int(place) for place in np.unravel_index(int(gain.argmax()), gain.shape))
        before, here, behind = gain[max(end - 1, 0), blur], gain[end, blur], gain[min(end + 1, _ENDS.size - 1), blur]
        bend = before - 2.0 * here + behind
        more = 0.5 * (before - behind) / bend * (_ENDS[1] - _ENDS[0]) if bend else 0.0
        left = math.sqrt(max(whole - float(here), 0.0) / level.size)
        return Edge(float(_ENDS[end] + more), float(_BLURS[blur]), float(height[end, blur]), left)


def _disc(radius: float, along: Plane, across: Plane) -> Plane:
    """How much of `across` is inside a disc around 0, at each place along."""
    distance = np.hypot(along[..., None], across)
    return np.asarray(np.clip(0.5 + (radius - distance) / 3.0, 0.0, 1.0).mean(axis=-1))
