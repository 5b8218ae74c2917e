"""A calibration by drawn images in virtual time; and one that is kept, and refused where it does not hold."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import pytest

from hil.camera.calibrate import Calibrator
from hil.camera.calibration import (
    Calibration,
    UncalibratedError,
    View,
    calibrated,
    calibration_path,
    keep,
    kept,
    stage_of,
)
from hil.camera.contract import CameraError, Image, Seen, Spot
from hil.camera.detector import Detector
from hil.camera.node import CameraNode
from hil.camera.readings import FirstSeen
from hil.rig.schema import RigConfig
from hil.runs.rigs import Rig
from hil.runs.virtual_mover import VirtualMover
from sim_plant.nodes.picture import Optics, Scene, picture
from tests.camera.rigs import camera_rig

FRAME_S = 1.0 / 30.0
STAGE = {"pixel": 2e-6, "image": [640, 480]}
ORIGIN = (1e-3, 2e-3)


class DrawnCamera:
    """A source in a rig's own virtual time: what its camera would show of the true stage."""

    def __init__(self, mover: VirtualMover, optics: Optics) -> None:
        self.mover, self.optics, self.number = mover, optics, 0

    def read(self) -> Image:
        self.mover.sleep(FRAME_S)
        x, y, z, _ = self.mover.true_position
        self.number += 1
        exposed_ns = self.mover.now_ns()
        pixels = picture(self.optics, Scene((x, y, z), cell=(0.1e-3, 0.05e-3)), self.number)
        self.mover.sleep(0.05)
        return Image(pixels, self.number, exposed_ns, self.mover.now_ns())

    def close(self) -> None: ...


def views(turn: float = 0.3, pixel: float = 2e-6, *, moves: bool = True, noise: float = 0.1) -> list[View]:
    """Of a camera turned by `turn`; `moves`: it sees the pipette go, else the cell."""
    draw, found = Random(1), []
    for x, y in [(0, 0), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1)]:
        way = x * 1e-4, y * 1e-4
        column = (way[0] * math.cos(turn) - way[1] * math.sin(turn)) / pixel
        row = (way[0] * math.sin(turn) + way[1] * math.cos(turn)) / pixel
        tip, cell = Spot(320.0, 240.0), Spot(350.0, 200.0)
        spot = Spot(column + draw.gauss(0, noise), row + draw.gauss(0, noise))
        if moves:
            tip = Spot(tip.column + spot.column, tip.row + spot.row)
        else:
            cell = Spot(cell.column - spot.column, cell.row - spot.row)
        found.append(View((ORIGIN[0] + way[0], ORIGIN[1] + way[1]), Seen(tip=tip, cell=cell)))
    return found


@pytest.mark.parametrize("moves", [True, False])
@pytest.mark.parametrize("turn", [0.0, 0.3, -2.5])
def test_scale_turn_and_tip_are_found_whichever_of_the_two_moves(turn: float, moves: bool) -> None:
    found = calibrated(views(turn, moves=moves), STAGE, 0.0)
    assert found.moves == moves
    assert found.pixel == pytest.approx(2e-6, rel=2e-3)
    assert found.turn == pytest.approx(turn, abs=2e-3)
    assert not found.mirrored
    assert math.dist(found.tip_at(ORIGIN), (320.0, 240.0)) < 0.2
    way = found.way(Spot(320.0, 240.0), Spot(350.0, 200.0))
    cos, sin = math.cos(turn), math.sin(turn)
    assert way == pytest.approx((2e-6 * (cos * 30 + sin * -40), 2e-6 * (-sin * 30 + cos * -40)), abs=3e-7)


def test_where_the_axes_carry_the_pipette_its_place_in_the_image_follows_the_encoders() -> None:
    found = calibrated(views(turn=0.0), STAGE, 0.0)
    assert math.dist(found.tip_at((ORIGIN[0] + 1e-4, ORIGIN[1])), (370.0, 240.0)) < 0.3


def test_a_mirror_shows() -> None:
    mirrored = [view._replace(encoders=(view.encoders[0], -view.encoders[1])) for view in views(turn=0.0)]
    assert calibrated(mirrored, STAGE, 0.0).mirrored


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (views(pixel=4e-6), r"a pixel is 4\.\d* um, camera.pixel = 2 um; allowed: within 30%"),
        (views(noise=5.0), r"leaves \d\.\d px RMS; allowed: 2"),
        (views()[:4], "seen in 4 of 4 images; expected 5"),
        ([view._replace(encoders=(view.encoders[0], 2e-3)) for view in views()], "along one line"),
        ([view._replace(encoders=ORIGIN) for view in views()], "along one line"),
        ([view._replace(seen=view.seen._replace(cell=None)) for view in views(moves=False)], "seen in 0 of 8 images"),
        ([view._replace(encoders=(view.encoders[0], 1.2 * view.encoders[1])) for view in views()], "square"),
    ],
)
def test_images_that_tell_nothing_are_refused_in_words(wrong: list[View], words: str) -> None:
    with pytest.raises(CameraError, match=words):
        calibrated(wrong, STAGE, 0.0)


@pytest.mark.long
@pytest.mark.parametrize("centre", [None, (0.1e-3, 0.05e-3)])
def test_moves_of_a_rig_calibrate_its_camera(centre: tuple[float, float] | None) -> None:
    rig = camera_rig()
    assert rig.camera is not None
    optics = Optics(pixel=2.6e-6, turn=0.1, aside=(2e-5, -1e-5), centre=centre, noise=0.01)
    told: list[str] = []
    with VirtualMover(Rig(rig, Path(), Path())) as mover:
        begin = mover.status().position
        interpreter = FirstSeen(rig.camera)
        node = CameraNode(rig, Detector(), interpreter, None)
        found = Calibrator(rig, mover, DrawnCamera(mover, optics), node.look, told.append).run(0.1e-3)
        end = mover.status().position
    assert found.moves == (centre is not None)
    assert found.pixel == pytest.approx(2.6e-6, rel=3e-3)
    assert found.turn == pytest.approx(0.1, abs=3e-3)
    assert found.left < 1.0
    assert len(told) == 10
    assert end[:2] == pytest.approx(begin[:2], abs=1e-6)


# kept ----------------------------------------------------------------------------------------------------------------


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RigConfig:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    return camera_rig()


def made(rig: RigConfig, made_s: float = 1000.0) -> Calibration:
    stage = stage_of(rig, (480, 640))
    return replace(calibrated(views(pixel=2.5e-6), stage, made_s), stage=stage)


def test_what_is_kept_is_found_again(rig: RigConfig) -> None:
    path = keep(rig, made(rig))
    assert path == calibration_path(rig)
    assert kept(rig, (480, 640), now_s=1500.0) == made(rig)


def test_a_calibration_is_refused_when_it_is_older_than_the_rig_says(rig: RigConfig) -> None:
    keep(rig, made(rig))
    assert rig.camera is not None
    age = rig.camera.calibration_age
    assert kept(rig, (480, 640), now_s=1000.0 + age)
    for now_s in (1001.0 + age, 999.0):
        with pytest.raises(UncalibratedError, match="calibration_age"):
            kept(rig, (480, 640), now_s=now_s)


def test_a_calibration_is_refused_for_another_stage_or_scale(rig: RigConfig) -> None:
    keep(rig, made(rig))
    others = [
        ("axes", camera_rig("axes.x.encoder_resolution=1e-8"), (480, 640)),
        ("axes", camera_rig("axes.y.offset=0.001"), (480, 640)),
        ("pixel", camera_rig("camera.pixel=2.4e-6"), (480, 640)),
        ("image", rig, (240, 320)),
    ]
    for key, other, shape in others:
        with pytest.raises(UncalibratedError, match=f"made for {key} ="):
            kept(other, shape, now_s=1001.0)
    with pytest.raises(UncalibratedError, match="no calibration"):
        kept(camera_rig("name=another"), (480, 640), now_s=1001.0)


@pytest.mark.parametrize(
    "damage",
    [
        lambda found: {**found, "format": 2},
        lambda found: {**found, "scale": [[0.0, 0.0], [0.0, 0.0]]},
        lambda found: {**found, "tip": ["a", 1.0]},
        lambda found: {**found, "tip": [math.inf, 1.0]},
        lambda found: {},
        lambda found: [],
    ],
)
def test_a_damaged_file_is_refused(rig: RigConfig, damage: Callable[[Any], Any]) -> None:
    path = keep(rig, made(rig))
    path.write_text(json.dumps(damage(json.loads(path.read_text()))))
    with pytest.raises(UncalibratedError, match=str(path)):
        kept(rig, (480, 640), now_s=1001.0)
