"""Finds the pipette: a dark line from the image's border to its end, the tip."""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from hil.camera.contract import Spot
from hil.camera.edge import EdgeFit

Plane = NDArray[np.float64]

_TURNS: Final = np.radians(np.arange(-15.0, 16.0))  # tried on either side of the stated direction
_OUTER: Final = 24  # blocks at the border that a direction is judged by
_BAND: Final = np.arange(-2.0, 3.0)  # px across, on the pipette even at its end
_REACHES: Final = 25.0, 14.0  # px to both sides of the end, in which its edge is fitted
_MOST_LEFT: Final = 6.0  # px that the second fit may move it
_LEAST_EDGE: Final = 0.08  # of the image's mean: the contrast of a pipette
_LEAST_RATIO: Final = 5.0  # of that contrast over what the fit leaves


class Pipette(NamedTuple):
    """tip: its end. along: rad, from there to the holder. blur: px, standard deviation of the edge at the end."""

    tip: Spot
    along: float
    blur: float


class Pipettes:
    """shaft: rad, the stated direction. widest: px. coarse: px a block."""

    def __init__(self, shaft: float, widest: float, coarse: int) -> None:
        self._shaft, self._coarse = shaft, coarse
        side = widest / 2.0 + np.arange(2.0, 9.0)
        self._sides = np.concatenate([-side[::-1], side])
        self._middle = np.arange(-widest / 2.0 - 6.0, widest / 2.0 + 7.0)
        self._lines: dict[tuple[int, ...], tuple[NDArray[np.intp], Plane]] = {}
        near = widest / 4.0 + np.arange(5.0)
        self._beside = np.concatenate([-near[::-1], near])  # a bolus is round: what is close beside the end has it, too
        self._fits = [EdgeFit(reach, _BAND, self._beside, discs=True) for reach in _REACHES]

    def find(self, image: Plane, dark: Plane) -> Pipette | None:
        """image: smoothed. dark: how much darker than around it each block is."""
        line = self._line(dark)
        if line is None:
            return None
        at, along = line
        for _ in range(2):
            end = self._rough_end(image, at, along)
            if end is None:
                return None
            at, along = self._straightened(image, end, along)
        return self._fine(image, at, along)

    def _line(self, dark: Plane) -> tuple[Spot, float] | None:
        """A place where it crosses the border, and its direction: the darkest of all lines there."""
        indices, angles = self._lines.get(dark.shape) or self._prepared(dark.shape)
        score = dark.ravel()[indices].mean(axis=2)
        turn, line = np.unravel_index(int(score.argmax()), score.shape)
        if score[turn, line] < _LEAST_EDGE / 2.0:
            return None
        row, column = np.unravel_index(indices[turn, line, -1], dark.shape)
        half = (self._coarse - 1) / 2.0
        return Spot(column * self._coarse + half, row * self._coarse + half), float(angles[turn])

    def _prepared(self, shape: tuple[int, ...]) -> tuple[NDArray[np.intp], Plane]:
        """Blocks of every line to try, from inside to the border; shape (turns, lines, _OUTER)."""
        rows, columns = shape
        angles = self._shaft + _TURNS
        reach = math.hypot(rows, columns) / 2.0
        found = []
        for angle in angles:
            across = np.arange(-reach, reach)
            middle = Spot((columns - 1) / 2.0, (rows - 1) / 2.0)
            row, column = _places(middle, angle, *np.meshgrid(np.arange(-reach, reach), across, indexing="ij"))
            inside = (row > -0.5) & (row < rows - 0.5) & (column > -0.5) & (column < columns - 0.5)
            last = inside.shape[0] - 1 - inside[::-1].argmax(axis=0)
            long = inside.sum(axis=0) >= _OUTER
            steps = np.maximum(last - np.arange(_OUTER - 1, -1, -1)[:, None], 0).T  # (lines, _OUTER)
            lines = np.arange(across.size)[:, None]
            r, c = np.rint(row[steps, lines]).astype(int), np.rint(column[steps, lines]).astype(int)
            flat = np.clip(r, 0, rows - 1) * columns + np.clip(c, 0, columns - 1)
            flat[~long] = 0
            found.append(flat)
        self._lines[shape] = np.array(found), angles
        return self._lines[shape]

    def _contrast(self, image: Plane, at: Spot, along: float, places: Plane, sides: Plane) -> Plane:
        """How much darker the line is than what is beside it, at each of `places` along it; NaN outside the image.
        sides: px across.
        """
        band = _sampled(image, at, along, places, _BAND).mean(axis=1)
        beside = _sampled(image, at, along, places, sides)
        return np.asarray(np.nanmean(np.where(np.isnan(band)[:, None], 0.0, beside), axis=1) - band)

    def _rough_end(self, image: Plane, at: Spot, along: float) -> Spot | None:
        """Where the contrast steps up for good, by the two means that fit best."""
        places = np.arange(-math.hypot(*image.shape), 40.0)
        contrast = self._contrast(image, at, along, places, self._sides)
        inside = ~np.isnan(contrast)
        places, contrast = places[inside], contrast[inside]
        if places.size < 40:
            return None
        sums, count = np.cumsum(contrast), np.arange(1, contrast.size + 1)
        low, high = sums[:-1] / count[:-1], (sums[-1] - sums[:-1]) / (contrast.size - count[:-1])
        between = count[:-1] * (contrast.size - count[:-1]) * np.maximum(high - low, 0.0) ** 2
        place = int(between[10:-10].argmax()) + 10
        if high[place] - low[place] < _LEAST_EDGE:
            return None
        return _moved(at, along, float(places[place]))

    def _straightened(self, image: Plane, end: Spot, along: float) -> tuple[Spot, float]:
        """The same end and direction, by the middle of the dark across the line behind the end."""
        places = np.arange(6.0, 90.0, 2.0)
        across = _sampled(image, end, along, places, self._middle)
        edges = np.concatenate([across[:, :4], across[:, -4:]], axis=1).mean(axis=1, keepdims=True)
        dark = np.maximum(edges - across - 0.3 * (edges - across.min(axis=1, keepdims=True)), 0.0)
        weight = dark.sum(axis=1)
        good = np.isfinite(weight) & (weight > 0.0)
        if good.sum() < 8:
            return end, along
        places, middle = places[good], (dark[good] * self._middle).sum(axis=1) / weight[good]
        slope, offset = np.polyfit(places, middle, 1)
        for _ in range(2):
            left = np.abs(middle - offset - slope * places)
            near = left <= 2.5 * max(float(np.median(left)), 0.05)
            slope, offset = np.polyfit(places[near], middle[near], 1)
        turned = along + math.atan(slope)
        return Spot(end.column - offset * math.sin(along), end.row + offset * math.cos(along)), turned

    def _fine(self, image: Plane, at: Spot, along: float) -> Pipette | None:
        """The middle of the edge: once in a wide window, then in a narrow one around what was found."""
        for fit in self._fits:
            contrast = self._contrast(image, at, along, fit.places, self._beside)
            if np.isnan(contrast).any():
                return None
            edge = fit.fit(contrast)
            at = _moved(at, along, edge.end)
        if abs(edge.end) > _MOST_LEFT or edge.height < max(_LEAST_EDGE, _LEAST_RATIO * edge.left):
            return None
        return Pipette(at, along, edge.blur)


def _places(at: Spot, angle: float, along: Plane, across: Plane) -> tuple[Plane, Plane]:
    cos, sin = math.cos(angle), math.sin(angle)
    return at.row + along * sin + across * cos, at.column + along * cos - across * sin


def _sampled(image: Plane, at: Spot, angle: float, along: Plane, across: Plane) -> Plane:
    """Shape (along, across); NaN outside the image."""
    grid = np.meshgrid(along, across, indexing="ij")
    return np.asarray(map_coordinates(image, _places(at, angle, *grid), order=1, cval=np.nan))


def _moved(at: Spot, angle: float, way: float) -> Spot:
    return Spot(at.column + way * math.cos(angle), at.row + way * math.sin(angle))
