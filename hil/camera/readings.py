"""From what an image shows, in pixels, to the quantities of [camera] sends, in the coordinates of the axes.

The vector from the tip to the cell in the image is the scale times the way that the axes still have to go, whichever of
the two moves in the image. So a camera that stands still and one that goes with the pipette need the same arithmetic.
"""

import math
from typing import Final

from hil.camera.calibration import Calibration, Way, stated
from hil.camera.contract import Seen
from hil.rig.camera import CameraConfig

_REST: Final = 1e-4  # m/s; faster axes take the image's latency for a way
_NEXT: Final = 0.5  # of a cell's radius; a cell farther away is another one


class Interpreter:
    """calibration: None where nothing needs one."""

    def __init__(self, camera: CameraConfig, calibration: Calibration | None) -> None:
        self._camera, self._calibration = camera, calibration
        self._first: Way | None = None  # where the cell in sight was first seen

    def quantities(self, seen: Seen, encoders: Way | None, speed: float) -> dict[str, float]:
        """What the image shows of all that [camera] can send; what it does not show is left out.

        encoders: positions of the two axes at the exposure, m; None: not known. speed: theirs, m/s.
        """
        camera, found = self._camera, dict[str, float]()
        pixel = camera.pixel if self._calibration is None else self._calibration.pixel
        if seen.dimple is not None:
            found["dimple"] = seen.dimple * pixel
        if seen.bolus is not None:
            found["bolus"] = seen.bolus * pixel**2 / camera.full_bolus
        if seen.tip_blur is not None:
            found["tip_z"] = camera.depth_per_blur * max(seen.tip_blur - camera.sharp, 0.0)
        if self._calibration is not None and encoders is not None:
            self._placed(found, self._calibration, seen, encoders, speed)
        return found

    def _placed(
        self, found: dict[str, float], calibration: Calibration, seen: Seen, encoders: Way, speed: float
    ) -> None:
        expected = calibration.tip_at(encoders)
        if seen.tip is not None:
            off = calibration.way(expected, seen.tip)
            found["tip_error"] = math.hypot(*off)
            found["tip_x"], found["tip_y"] = encoders[0] + off[0], encoders[1] + off[1]
        if seen.cell is not None:
            way = calibration.way(expected, seen.cell)
            cell = encoders[0] + way[0], encoders[1] + way[1]
            found["cell_x"], found["cell_y"] = cell
            shift = self._shift(cell, (seen.cell_radius or 0.0) * calibration.pixel, speed)
            if shift is not None:
                found["cell_shift"] = shift

    def _shift(self, cell: Way, radius: float, speed: float) -> float | None:
        """Way of the cell since it was first seen with the axes at rest; None: it was not yet."""
        first = self._first
        if first is None or math.dist(first, cell) > _NEXT * radius:
            self._first = cell if speed <= _REST else None
            return 0.0 if self._first else None
        return math.dist(first, cell)


class FirstSeen(Interpreter):
    """Before there is a calibration: by the stated pixel, and against the first place of the tip."""

    def __init__(self, camera: CameraConfig) -> None:
        super().__init__(camera, None)

    def quantities(self, seen: Seen, encoders: Way | None, speed: float) -> dict[str, float]:
        """As Interpreter's."""
        if self._calibration is None and seen.tip is not None:
            self._calibration = stated(self._camera, seen.tip)
        return super().quantities(seen, encoders, speed)
