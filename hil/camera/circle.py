"""Finds the cell: a circle through the dark rim.

Roughly by the gradients at the rim, which point to or from its middle (circular Hough transform: Duda and Hart, Comm.
ACM 15, 1972). Then by the darkest places along rays from that middle, through which a circle is laid (Kasa, IEEE Trans.
Instrum. Meas. 25, 1976), those that do not fit left out.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, sobel

from hil.camera.contract import Spot
from hil.camera.pipette import Pipette

Plane = NDArray[np.float64]

_STRONGEST: Final = 2500  # blocks that vote
_RAYS: Final = np.arange(0.0, 2.0 * math.pi, math.pi / 120.0)
_WIDE: Final = np.arange(-40.0, 41.0, 2.0)  # px around the rough radius in which the rim is looked for
_STEPS: Final = np.arange(-14.0, 14.25, 0.5)  # then
_LEAST_SHARE: Final = 0.5  # of the rays on which the rim must be found
_LEAST_DARK: Final = 0.03  # of the image's mean
_MOST_LEFT: Final = 2.5  # px, root mean square


class Circles:
    """radius: least and greatest, over the image's height. widest: px, of the pipette. coarse: px a block."""

    def __init__(self, radius: tuple[float, float], widest: float, coarse: int) -> None:
        self._radius, self._beside, self._coarse = radius, widest / 2.0 + 6.0, coarse

    def find(self, image: Plane, blocks: Plane, dark: Plane, pipette: Pipette | None) -> tuple[Spot, float] | None:
        """Middle and radius, px. image: smoothed. dark: how much darker than around it each block is."""
        rough = self._rough(blocks, dark, pipette)
        if rough is None:
            return None
        found = self._darkest(image, *rough, pipette)
        for _ in range(2):
            found = found and self._refined(image, *found, pipette)
        if found is None:
            return None
        middle, radius = found
        low, high = (share * image.shape[0] for share in self._radius)
        return (middle, radius) if low - 1.0 <= radius <= high + 1.0 else None

    def _rough(self, blocks: Plane, dark: Plane, pipette: Pipette | None) -> tuple[Spot, float] | None:
        rows, columns = blocks.shape
        soft = gaussian_filter(blocks, 1.0)
        down, right = sobel(soft, 0), sobel(soft, 1)
        strength = np.hypot(down, right)
        strength[[0, -1], :] = strength[:, [0, -1]] = 0.0
        grid_rows, grid_columns = np.mgrid[:rows, :columns]
        strength[self._is_pipette(grid_rows * self._coarse, grid_columns * self._coarse, pipette)] = 0.0
        flat = np.argpartition(strength.ravel(), -min(_STRONGEST, strength.size))[-_STRONGEST:]
        flat = flat[strength.ravel()[flat] > 1e-9]
        row, column = np.unravel_index(flat, blocks.shape)
        turn_row, turn_column = down[row, column] / strength[row, column], right[row, column] / strength[row, column]
        radii = np.arange(*(share * rows for share in self._radius))
        if not radii.size or not flat.size:
            return None
        ways = np.concatenate([-radii, radii])[:, None]
        to_row = np.rint(row + ways * turn_row).astype(int).ravel()
        to_column = np.rint(column + ways * turn_column).astype(int).ravel()
        inside = (to_row >= 0) & (to_row < rows) & (to_column >= 0) & (to_column < columns)
        votes = np.bincount(to_row[inside] * columns + to_column[inside], minlength=rows * columns)
        best = int(gaussian_filter(votes.reshape(rows, columns).astype(float), 1.5).argmax())
        middle = Spot(*(float(value) for value in np.unravel_index(best, blocks.shape)[::-1]))
        ring_rows = middle.row + radii[:, None] * np.sin(_RAYS)
        ring_columns = middle.column + radii[:, None] * np.cos(_RAYS)
        rings = np.nan_to_num(map_coordinates(dark, (ring_rows, ring_columns), order=1, cval=np.nan))
        half = (self._coarse - 1) / 2.0
        radius = float(radii[int(np.median(rings, axis=1).argmax())])
        return Spot(middle.column * self._coarse + half, middle.row * self._coarse + half), radius * self._coarse

    def _is_pipette(self, rows: Plane, columns: Plane, pipette: Pipette | None) -> NDArray[np.bool_]:
        if pipette is None:
            return np.zeros(np.broadcast(rows, columns).shape, bool)
        cos, sin = math.cos(pipette.along), math.sin(pipette.along)
        down, right = rows - pipette.tip.row, columns - pipette.tip.column
        return np.asarray((np.abs(down * cos - right * sin) < self._beside) & (right * cos + down * sin > -10.0))

    def _darkest(self, image: Plane, middle: Spot, radius: float, pipette: Pipette | None) -> tuple[Spot, float] | None:
        lengths = radius + _WIDE
        columns = middle.column + lengths * np.cos(_RAYS)[:, None]
        rows = middle.row + lengths * np.sin(_RAYS)[:, None]
        across = map_coordinates(image, (rows, columns), order=1, cval=np.inf)
        away = ~self._is_pipette(rows, columns, pipette).any(axis=1) & np.isfinite(across).any(axis=1)
        if away.sum() < _RAYS.size / 3:
            return None
        length = lengths[across[away].argmin(axis=1)]
        return _circle(length * np.cos(_RAYS[away]), length * np.sin(_RAYS[away]), middle, 0, 1e3)

    def _refined(self, image: Plane, middle: Spot, radius: float, pipette: Pipette | None) -> tuple[Spot, float] | None:
        lengths = radius + _STEPS
        columns = middle.column + lengths * np.cos(_RAYS)[:, None]
        rows = middle.row + lengths * np.sin(_RAYS)[:, None]
        across = map_coordinates(image, (rows, columns), order=1, cval=np.nan)
        away = ~self._is_pipette(rows, columns, pipette).any(axis=1)
        level = np.linspace(across[:, :4].mean(axis=1), across[:, -4:].mean(axis=1), _STEPS.size, axis=1)
        dark = level - across
        depth = dark.max(axis=1)
        weight = np.maximum(dark - 0.5 * depth[:, None], 0.0)
        good = np.isfinite(depth) & away & (depth > _LEAST_DARK)
        if good.sum() < _LEAST_SHARE * np.isfinite(depth).sum() or good.sum() < _RAYS.size / 3:
            return None
        length = (weight[good] * lengths).sum(axis=1) / weight[good].sum(axis=1)
        x, y = length * np.cos(_RAYS[good]), length * np.sin(_RAYS[good])
        return _circle(x, y, middle, int(away.sum()), _MOST_LEFT)


def _circle(x: Plane, y: Plane, middle: Spot, rays: int, most: float) -> tuple[Spot, float] | None:
    """Through most of the places x, y, px from the middle. rays: of which a quarter must fit. most: px RMS, of those
    that fit.
    """
    near = np.ones(x.size, bool)
    for _ in range(4):
        matrix = np.column_stack([x[near], y[near], np.ones(int(near.sum()))])
        (a, b, c), *_ = np.linalg.lstsq(matrix, x[near] ** 2 + y[near] ** 2, rcond=None)
        radius = math.sqrt(max(c + a * a / 4.0 + b * b / 4.0, 0.0))
        left = np.abs(np.hypot(x - a / 2.0, y - b / 2.0) - radius)
        near = left <= 3.0 * max(float(np.median(left)), 0.1)
    if near.sum() < _LEAST_SHARE * rays / 2.0 or math.sqrt(float((left[near] ** 2).mean())) > most:
        return None
    return Spot(middle.column + a / 2.0, middle.row + b / 2.0), radius
