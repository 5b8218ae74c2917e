"""The detector that comes with hil: a dark pipette above a round cell with a dark rim, in transmitted light.

1. Dark and narrow things stand out by a grey closing: the pipette, and the rim of the cell.
2. The pipette is the line along which they reach the image's border, on the side that `shaft` says (pipette.py).
3. The cell is a circle through the rim (circle.py).
4. Dimple and bolus are the dark or bright spot around the tip (spot.py).
"""

import math
from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter, grey_closing

from hil.camera.circle import Circles
from hil.camera.contract import Features, Pixels, Seen
from hil.camera.pipette import Pipettes
from hil.camera.spot import around

COARSE: Final = 4  # pixels of a block, in which things are found roughly


class Detector(Features):
    """shaft: direction in the image from the tip to its holder, degrees, 0 to the right and 90 down; 15 to either side
    are found. radius: least and greatest radius of a cell over the image's height. widest: px, greatest width of the
    pipette in the image. Raises ValueError.
    """

    def __init__(self, shaft: float = 0.0, radius: tuple[float, float] = (0.2, 0.48), widest: float = 32.0) -> None:
        for name, value, low, high in (("shaft", shaft, -360.0, 360.0), ("widest", widest, 8.0, 200.0)):
            if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
                raise ValueError(f"camera.parameters.{name} = {value!r:.40}; allowed: from {low:g} to {high:g}")
        if len(radius) != 2 or not 0.05 <= radius[0] < radius[1] <= 1.0:
            raise ValueError(f"camera.parameters.radius = {radius!r:.40}; allowed: [least, greatest], 0.05 to 1")
        self._pipettes = Pipettes(math.radians(shaft), widest, COARSE)
        self._circles = Circles((float(radius[0]), float(radius[1])), widest, COARSE)
        self._closing = round(1.3 * widest / COARSE) | 1

    def of(self, image: Pixels, stamp: int) -> Seen:
        """The features of one image."""
        whole = image.astype(np.float64)
        whole /= max(float(whole.mean()), 1e-12)
        rows, columns = (size - size % COARSE for size in whole.shape)
        blocks = whole[:rows, :columns].reshape(rows // COARSE, COARSE, columns // COARSE, COARSE).mean(axis=(1, 3))
        dark = grey_closing(blocks, (self._closing, self._closing)) - blocks
        smooth = gaussian_filter(whole, 1.0)
        pipette = self._pipettes.find(smooth, dark)
        cell = self._circles.find(smooth, blocks, dark, pipette)
        middle, radius = cell or (None, None)
        if pipette is None:
            return Seen(None, None, middle, radius)
        dimple, bolus = around(smooth, pipette)
        return Seen(pipette.tip, pipette.blur, middle, radius, dimple, bolus)
