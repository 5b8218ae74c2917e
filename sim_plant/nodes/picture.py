"""Images of a pipette above a cell, as a microscope from above has them: drawn from what is true, pixel by pixel.

Every edge is one pixel wide before defocus blurs it, so that positions between pixels show. All that is drawn is
assumed; what a program makes of such images is held against the scene alone.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Grid = NDArray[np.float64]
Spot = tuple[float, float]

LEAN: Final = 0.2  # way across that a broken pipette lacks, over the one along its axis
_RIM: Final = 4e-6  # m, half the width of a cell's rim
_TIP: Final = 8e-6  # m, half the width of the pipette's end
_TAPER: Final = 0.03  # by which that grows along the pipette
_TEXTURE: Final = 24  # blotches a cell


class Scene(NamedTuple):
    """What is in front of the camera; m, in the coordinates of the stage.

    tip: x, y, z of a whole pipette's. missing: what it lacks along its axis. cell: middle of the one below it; None:
    there is none. radius, dimple: of the cell. bolus: 1 is a full one. number: of the cell, for its texture.
    """

    tip: tuple[float, float, float]
    missing: float = 0.0
    cell: Spot | None = None
    radius: float = 0.5e-3
    dimple: float = 0.0
    bolus: float = 0.0
    number: int = 0


@dataclass(frozen=True)
class Optics:
    """A camera. width, height: px. pixel: m per px. turn: rad, from the stage's x to the image's columns.
    shaft: rad, direction in the image from the tip to its holder. centre: m, what the middle of the image shows; None:
    the camera moves with the pipette, which is `aside` m away. focus: z of the plane in focus, m. blur, depth: px of
    blur there, and px more per m away. light: how much darker corners are. noise: RMS, 1 is white. full: m, radius of
    a full bolus. seed: of the noise.
    """

    width: int = 640
    height: int = 480
    pixel: float = 2.5e-6
    turn: float = 0.0
    shaft: float = 0.0
    centre: Spot | None = None
    aside: Spot = (0.0, 0.0)
    focus: float = 0.0
    blur: float = 0.8
    depth: float = 0.0
    light: float = 0.2
    noise: float = 0.01
    full: float = 40e-6
    seed: int = 1

    def spot(self, scene: Scene, x: float, y: float) -> Spot:
        """Column and row of a place of the stage, px; the middle of the first pixel is 0, 0."""
        centre = self.centre or (scene.tip[0] - self.aside[0], scene.tip[1] - self.aside[1])
        dx, dy = (x - centre[0]) / self.pixel, (y - centre[1]) / self.pixel
        cos, sin = math.cos(self.turn), math.sin(self.turn)
        return (self.width - 1) / 2 + cos * dx - sin * dy, (self.height - 1) / 2 + sin * dx + cos * dy

    def tip(self, scene: Scene) -> Spot:
        """Column and row of the pipette's end."""
        column, row = self.spot(scene, scene.tip[0], scene.tip[1])
        short = LEAN * scene.missing / self.pixel
        return column + short * math.cos(self.shaft), row + short * math.sin(self.shaft)

    def cell(self, scene: Scene) -> Spot | None:
        """Column and row of the cell's middle."""
        return None if scene.cell is None else self.spot(scene, *scene.cell)


def picture(optics: Optics, scene: Scene, number: int) -> NDArray[np.uint8]:
    """Frame `number`, shape (height, width), 0 to 255."""
    from scipy.ndimage import gaussian_filter  # it takes long to import, and who emulates a stage draws seldom

    rows, columns = np.mgrid[: optics.height, : optics.width].astype(np.float64)
    away = abs(scene.tip[2] - optics.focus)
    light = _light(optics, rows, columns) * gaussian_filter(_cell(optics, scene, rows, columns), optics.blur)
    light *= gaussian_filter(_pipette(optics, scene, rows, columns), optics.blur + optics.depth * away)
    light += optics.noise * np.random.default_rng((optics.seed, number)).standard_normal(light.shape)
    return np.asarray(np.clip(np.rint(255.0 * light), 0, 255).astype(np.uint8))


def _light(optics: Optics, rows: Grid, columns: Grid) -> Grid:
    """Brighter on one side, and darker in the corners."""
    across = (columns / optics.width - 0.5) + 0.5 * (rows / optics.height - 0.5)
    corners = (columns / optics.width - 0.5) ** 2 + (rows / optics.height - 0.5) ** 2
    return np.asarray(0.7 * (1.0 + optics.light * (across - 2.0 * corners)))


def _inside(distance: Grid) -> Grid:
    """1 inside, 0 outside, with an edge of one pixel. distance: px, negative inside."""
    return np.asarray(np.clip(0.5 - distance, 0.0, 1.0))


def _cell(optics: Optics, scene: Scene, rows: Grid, columns: Grid) -> Grid:
    """What passes through the cell, its dimple and its bolus."""
    passes = np.ones_like(rows)
    middle = optics.cell(scene)
    tip = optics.tip(scene)
    if middle is None:
        return passes
    distance = np.hypot(columns - middle[0], rows - middle[1])
    radius = scene.radius / optics.pixel
    inside = _inside(distance - radius)
    passes -= inside * (0.12 + _texture(scene, (rows - middle[1]) / radius, (columns - middle[0]) / radius))
    passes -= 0.3 * _inside(np.abs(distance - radius) - _RIM / optics.pixel)
    from_tip = np.hypot(columns - tip[0], rows - tip[1])
    if scene.dimple > 0.0:
        passes -= 0.2 * inside * np.exp2(-((from_tip * optics.pixel / scene.dimple) ** 2))
    if scene.bolus > 0.0:
        passes += 0.2 * inside * _inside(from_tip - math.sqrt(scene.bolus) * optics.full / optics.pixel)
    return passes


def _texture(scene: Scene, rows: Grid, columns: Grid) -> Grid:
    """Blotches, the same in every frame of a cell. rows, columns: from its middle, over its radius."""
    places = np.random.default_rng(scene.number).standard_normal((_TEXTURE, 3))
    found = np.zeros_like(rows)
    for row, column, strength in places:
        near = (rows - 0.4 * row) ** 2 + (columns - 0.4 * column) ** 2
        found += 0.015 * strength * np.exp(-near / 0.02)
    return found


def _pipette(optics: Optics, scene: Scene, rows: Grid, columns: Grid) -> Grid:
    """What passes beside the pipette."""
    tip = optics.tip(scene)
    cos, sin = math.cos(optics.shaft), math.sin(optics.shaft)
    along = (columns - tip[0]) * cos + (rows - tip[1]) * sin
    across = np.abs((rows - tip[1]) * cos - (columns - tip[0]) * sin)
    beside = across - _TIP / optics.pixel - _TAPER * np.maximum(along, 0.0)
    return np.asarray(1.0 - 0.45 * _inside(np.maximum(-along, beside)))
