"""`hil camera RIG --calibrate`: moves the two axes by known steps and looks where tip and cell are."""

import time
from collections.abc import Callable
from typing import Final

from hil.camera.calibration import Calibration, View, calibrated, stage_of
from hil.camera.clock import Exposures
from hil.camera.contract import CameraError, Features, Source
from hil.camera.node import looked_at
from hil.rig.schema import RigConfig
from hil.runs.mover import Mover

# By steps; around the first place, and twice there, so that a stage that creeps shows.
PLACES: Final = ((0, 0), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (0, 0))
REST_S: Final = 0.1  # after the axes are in position, before an exposure counts
EACH: Final = 3  # images a place
_PATIENCE_S: Final = 10.0


def calibrate(
    rig: RigConfig, mover: Mover, source: Source, detector: Features, step: float, tell: Callable[[str], object]
) -> Calibration:
    """step: m. Ends where it began. Raises CameraError, and what Mover raises."""
    assert rig.camera is not None
    names = rig.camera.axes
    places = [mover.axes.index(name) for name in names]
    exposures = Exposures(round(rig.camera.latency * 1e9))
    shape: tuple[int, ...] = ()
    views: list[View] = []
    for number, (right, up) in enumerate(PLACES, 1):
        before = PLACES[number - 2] if number > 1 else (0, 0)
        steps = {names[0]: (right - before[0]) * step, names[1]: (up - before[1]) * step}
        mover.move_by(speed=1.0, line=False, **steps).wait()
        mover.sleep(REST_S)
        rests_ns = mover.now_ns()
        found = 0
        while found < EACH:
            if mover.now_ns() - rests_ns > _PATIENCE_S * 1e9:
                raise CameraError(f"no {EACH} images within {_PATIENCE_S:g} s")
            image = source.read()
            exposed_ns = exposures.of(image) if image else None
            if image is None or exposed_ns is None or exposed_ns < rests_ns:
                continue
            if shape and image.pixels.shape != shape:
                raise CameraError(f"an image of shape {image.pixels.shape} after those of {shape}")
            shape = image.pixels.shape
            position = mover.status().position
            seen = looked_at(detector, image, exposed_ns)
            views.append(View((position[places[0]], position[places[1]]), seen))
            found += 1
        last = views[-1].seen
        tell(f"place {number} of {len(PLACES)}: tip {_spot(last.tip)}, cell {_spot(last.cell)}")
    return calibrated(views, stage_of(rig, shape), time.time())


def _spot(spot: tuple[float, float] | None) -> str:
    return f"{spot[0]:.1f}, {spot[1]:.1f} px" if spot else "not seen"
