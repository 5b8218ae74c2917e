"""The calibration of a camera: what a pixel is along the axes, and where the tip is against their encoders.

From images at known positions of two axes. In an image at encoder positions q the tip is at

    tip(q) = tip + moves * scale (q - q0)

with `moves` 1 where the axes carry the pipette, and 0 where they carry the dish below a pipette that stands still. In
the second case the cells show the scale, moving the other way. `scale` is any matrix: it holds pixel, turn and mirror.
"""

import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from drivers.base.runtime import state_folder, write_private
from drivers.base.text_file import UnsuitableFileError, read_bounded
from hil.camera.contract import CameraError, Seen, Spot
from hil.rig.camera import CameraConfig
from hil.rig.schema import RigConfig

FORMAT: Final = 1
LEAST_IMAGES: Final = 5
_LARGEST: Final = 2**16  # bytes
_MOST_OFF: Final = 0.3  # by which a pixel may differ from the stated one
_MOST_LEFT: Final = 2.0  # px, root mean square, that the fit may leave
_MOST_SKEW: Final = 0.05  # by which the pixel along one axis may differ from that along the other

Way = tuple[float, float]


class UncalibratedError(CameraError):
    """There is no calibration that may be used; the text says why."""


class View(NamedTuple):
    """One image of a calibration. encoders: of the two axes, m, when it was exposed, at rest."""

    encoders: Way
    seen: Seen


@dataclass(frozen=True)
class Calibration:
    """scale: px per m; row 0 of columns, row 1 of rows; one place an axis. tip: px, at encoders `origin`, m. moves: the
    axes carry the pipette. left: px, root mean square. images: it is from. made_s: Unix time. stage: what it holds for.
    """

    scale: tuple[Way, Way]
    tip: Spot
    origin: Way
    moves: bool
    left: float
    images: int
    made_s: float
    stage: dict[str, Any]

    @property
    def pixel(self) -> float:
        """m, the geometric mean along the two axes."""
        (a, b), (c, d) = self.scale
        return 1.0 / math.sqrt(abs(a * d - b * c))

    @property
    def turn(self) -> float:
        """rad, from the first axis to the image's columns, positive towards its rows."""
        return math.atan2(self.scale[1][0], self.scale[0][0])

    @property
    def mirrored(self) -> bool:
        """The second axis lies on the other side of the first than the rows lie of the columns."""
        (a, b), (c, d) = self.scale
        return a * d - b * c < 0.0

    def tip_at(self, encoders: Way) -> Spot:
        """Where the tip is in an image exposed at these positions."""
        if not self.moves:
            return self.tip
        (a, b), (c, d) = self.scale
        x, y = encoders[0] - self.origin[0], encoders[1] - self.origin[1]
        return Spot(self.tip.column + a * x + b * y, self.tip.row + c * x + d * y)

    def way(self, begin: Spot, end: Spot) -> Way:
        """From one place of the image to another, m along the two axes."""
        (a, b), (c, d) = self.scale
        right, down = end.column - begin.column, end.row - begin.row
        all_ = a * d - b * c
        return (d * right - b * down) / all_, (a * down - c * right) / all_


def stated(camera: CameraConfig, tip: Spot) -> Calibration:
    """By the rig file alone: its pixel, no turn, and a tip that stands still."""
    return Calibration(((1.0 / camera.pixel, 0.0), (0.0, 1.0 / camera.pixel)), tip, (0.0, 0.0), False, 0.0, 0, 0.0, {})


def stage_of(rig: RigConfig, shape: Sequence[int]) -> dict[str, Any]:
    """What a calibration holds for: the two axes as the rig file has them, and the camera. shape: of its images."""
    assert rig.camera is not None
    axes = {name: rig.axes[name] for name in rig.camera.axes}
    return {
        "rig": rig.name,
        "axes": {
            name: [axis.encoder_resolution, axis.direction, axis.gear, axis.offset] for name, axis in axes.items()
        },
        "pixel": rig.camera.pixel,
        "image": [int(shape[1]), int(shape[0])],
    }


def calibrated(views: Sequence[View], stage: dict[str, Any], made_s: float) -> Calibration:
    """By least squares. Raises CameraError, saying what is wrong with the images or with what they show."""
    tips = [view for view in views if view.seen.tip]
    if len(tips) < LEAST_IMAGES:
        raise CameraError(f"the tip is seen in {len(tips)} of {len(views)} images; expected {LEAST_IMAGES} or more")
    origin = tips[0].encoders
    tip, scale, left = _fit(tips, [view.seen.tip for view in tips])
    travel = math.dist(*_corners([view.encoders for view in tips]))
    if travel <= 0.0:
        raise CameraError("the axes have not moved between the images: nothing can be told")
    nominal = 1.0 / float(stage["pixel"])
    moves = bool(np.linalg.norm(scale, 2) > 0.3 * nominal)
    if not moves:
        cells = [view for view in views if view.seen.cell]
        if len(cells) < LEAST_IMAGES:
            raise CameraError(
                f"the tip stands still, and a cell is seen in {len(cells)} of {len(views)} images: move a cell into "
                f"the picture; expected {LEAST_IMAGES} images or more with it"
            )
        tip = np.mean(np.array([view.seen.tip for view in tips], dtype=np.float64), axis=0)
        _, scale, left = _fit(cells, [view.seen.cell for view in cells])
        scale = -scale
    found = Calibration(
        ((float(scale[0, 0]), float(scale[0, 1])), (float(scale[1, 0]), float(scale[1, 1]))),
        Spot(float(tip[0]), float(tip[1])), origin, moves, left, len(tips), made_s, stage,
    )  # fmt: skip
    _check(found, scale, nominal)
    return found


def _fit(views: Sequence[View], spots: Sequence[Spot | None]) -> tuple[Any, Any, float]:
    """Place at the first encoder positions, px per m, and what is left, px RMS."""
    ways = np.array([view.encoders for view in views]) - np.array(views[0].encoders)
    if np.linalg.matrix_rank(ways - ways.mean(axis=0), tol=1e-7) < 2:
        raise CameraError("the images are from places along one line: both axes have to move")
    matrix = np.column_stack([np.ones(len(ways)), ways])
    places = np.array(spots, dtype=np.float64)
    found = np.linalg.lstsq(matrix, places, rcond=None)[0]
    left = places - matrix @ found
    return found[0], found[1:].T, float(np.sqrt((left**2).sum() / len(ways)))


def _corners(places: Sequence[Way]) -> tuple[Way, Way]:
    x, y = zip(*places, strict=True)
    return (min(x), min(y)), (max(x), max(y))


def _check(found: Calibration, scale: Any, nominal: float) -> None:
    if found.left > _MOST_LEFT:
        raise CameraError(f"the fit leaves {found.left:.1f} px RMS; allowed: {_MOST_LEFT:g}. Did the stage rest in "
                          "each image, and is it the same cell in all of them?")  # fmt: skip
    if not 1.0 - _MOST_OFF <= found.pixel * nominal <= 1.0 + _MOST_OFF:
        raise CameraError(f"a pixel is {found.pixel * 1e6:.4g} um, camera.pixel = {1e6 / nominal:.4g} um; allowed: "
                          f"within {_MOST_OFF:.0%}. Is it the objective that the rig file states?")  # fmt: skip
    along = np.linalg.norm(scale, axis=0)
    if abs(along[0] / along[1] - 1.0) > _MOST_SKEW:
        raise CameraError(f"a pixel is {1e6 / along[0]:.4g} um along one axis and {1e6 / along[1]:.4g} um along "
                          f"the other; allowed: {_MOST_SKEW:.0%} apart. Is the camera square to them?")  # fmt: skip


# kept ---------------------------------------------------------------------------------------------------------------


def calibration_path(rig: RigConfig) -> Path:
    """Of the rig's camera, below the state folder."""
    return state_folder() / "camera" / f"{rig.name}.json"


def keep(rig: RigConfig, found: Calibration) -> Path:
    """In the place of an earlier one. Raises OSError."""
    path = calibration_path(rig)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    write_private(path, json.dumps({"format": FORMAT, **asdict(found)}, indent=1) + "\n")
    return path


def kept(rig: RigConfig, shape: Sequence[int], now_s: float | None = None) -> Calibration:
    """The calibration that is kept, where it may be used. Raises UncalibratedError naming the file."""
    assert rig.camera is not None
    path = calibration_path(rig)
    try:
        found = json.loads(read_bounded(path, _LARGEST))
    except FileNotFoundError:
        raise UncalibratedError(f"{path}: no calibration") from None
    except (OSError, UnsuitableFileError, ValueError, RecursionError) as error:
        raise UncalibratedError(f"{path}: no calibration can be read: {error}") from None
    try:
        made = _read(found)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise UncalibratedError(f"{path}: not a calibration of this version") from None
    stage = stage_of(rig, shape)
    for name, value in stage.items():
        if made.stage.get(name) != value:
            raise UncalibratedError(f"{path}: made for {name} = {made.stage.get(name)!r:.80}, now {value!r:.80}")
    age = (time.time() if now_s is None else now_s) - made.made_s
    if not 0.0 <= age <= rig.camera.calibration_age:
        when = time.strftime("%Y-%m-%d %H:%M", time.localtime(made.made_s))
        raise UncalibratedError(
            f"{path}: of {when}, {age / 3600:.1f} h old; camera.calibration_age = {rig.camera.calibration_age:g} s "
            f"allows {rig.camera.calibration_age / 3600:.1f} h"
        )
    return made


def _read(found: Any) -> Calibration:
    if found["format"] != FORMAT or not isinstance(found["stage"], dict):
        raise ValueError
    (a, b), (c, d) = found["scale"]
    numbers = [float(v) for v in (a, b, c, d, *found["tip"], *found["origin"], found["left"], found["made_s"])]
    if len(numbers) != 10 or not all(map(math.isfinite, numbers)) or a * d - b * c == 0.0:
        raise ValueError
    return Calibration(
        ((numbers[0], numbers[1]), (numbers[2], numbers[3])), Spot(numbers[4], numbers[5]), (numbers[6], numbers[7]),
        bool(found["moves"]), numbers[8], int(found["images"]), numbers[9], found["stage"],
    )  # fmt: skip
