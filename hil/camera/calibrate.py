"""`hil camera RIG --calibrate`: moves the two axes by known steps and looks where tip and cell are."""

import time
from collections.abc import Callable
from typing import Final

from hil.camera.calibration import Calibration, View, calibrated, stage_of
from hil.camera.contract import CameraError, Image, Seen, Source
from hil.rig.schema import RigConfig
from hil.runs.mover import Mover

# By steps; around the first place, and twice there, so that a stage that creeps shows.
PLACES: Final = ((0, 0), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (0, 0))
REST_S: Final = 0.1  # after the axes are in position, before an exposure counts
EACH: Final = 3  # images a place
_PATIENCE_S: Final = 20.0

Look = Callable[[Image], tuple[int, Seen] | None]


class Calibrator:
    """source: of images. look: what makes of each its exposure (ns) and what it shows, also while the axes move: the
    rig stops where its camera falls silent. tell: a line a place.
    """

    def __init__(self, rig: RigConfig, mover: Mover, source: Source, look: Look, tell: Callable[[str], object]) -> None:
        assert rig.camera is not None
        self._rig, self._mover, self._source, self._look, self._tell = rig, mover, source, look, tell
        self._names = rig.camera.axes
        self._axes = [mover.axes.index(name) for name in self._names]
        self._shape: tuple[int, ...] = ()

    def run(self, step: float) -> Calibration:
        """step: m. Ends where it began. Raises CameraError, and what Mover raises."""
        views: list[View] = []
        before = (0, 0)
        for number, place in enumerate(PLACES, 1):
            steps = {name: (place[k] - before[k]) * step for k, name in enumerate(self._names)}
            views += self._views(steps)
            before, last = place, views[-1].seen
            self._tell(f"place {number} of {len(PLACES)}: tip {_spot(last.tip)}, cell {_spot(last.cell)}")
        return calibrated(views, stage_of(self._rig, self._shape), time.time())

    def _views(self, steps: dict[str, float]) -> list[View]:
        """The images of one place, once the axes rest there."""
        mover, found = self._mover, list[View]()
        began_ns, rests_ns = mover.now_ns(), 0
        move = mover.move_by(speed=1.0, line=False, **steps)
        while len(found) < EACH:
            if mover.now_ns() - began_ns > _PATIENCE_S * 1e9:
                raise CameraError(f"no {EACH} images of axes at rest within {_PATIENCE_S:g} s")
            image = self._source.read()
            looked = self._look(image) if image else None
            if not rests_ns and move.done:
                rests_ns = mover.now_ns() + round(REST_S * 1e9)
            if image is None or looked is None or not rests_ns or looked[0] < rests_ns:
                continue
            self._check(image)
            position = mover.status().position
            found.append(View((position[self._axes[0]], position[self._axes[1]]), looked[1]))
        return found

    def _check(self, image: Image) -> None:
        shape = image.pixels.shape
        if self._shape and shape != self._shape:
            raise CameraError(f"an image of shape {shape} after those of {self._shape}")
        self._shape = shape


def _spot(spot: tuple[float, float] | None) -> str:
    return f"{spot[0]:.1f}, {spot[1]:.1f} px" if spot else "not seen"
