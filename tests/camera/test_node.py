"""From an image to the host's readings: what is seen, in the coordinates of the axes, with its age; and what is not."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.sensors.readers import sensor_readers
from hil.camera.calibration import Calibration
from hil.camera.contract import CameraError, Features, Image, Pixels, Seen, Spot, grey
from hil.camera.encoders import Encoders
from hil.camera.kept_images import KeptImages
from hil.camera.node import CameraNode, detector_of
from hil.camera.readings import Interpreter
from hil.camera.sources.folder import Folder
from hil.cycle.readings import Readings
from hil.rig.camera import CameraConfig
from hil.rig.file import load_rig
from hil.rig.schema import RigError
from tests.camera.rigs import CAMERA, RIG, camera_rig

MS = 1_000_000
# A pixel of 2.5 um, the camera turned by 90 degrees: the first axis goes down the rows.
TURNED = Calibration(
    ((0.0, -4e5), (4e5, 0.0)), Spot(320.0, 240.0), (0.0, 0.0), False, 0.1, 9, 0.0, {"pixel": 2.5e-6}
)  # fmt: skip
TIP = Spot(320.0, 240.0)


class Said(Features):
    """A detector that sees what it is told."""

    def __init__(self, seen: Seen) -> None:
        self.seen = seen

    def of(self, image: Pixels, stamp: int) -> Seen:
        return self.seen


class Bench:
    """A node beside the host's readings; `show` an image that the node sees so."""

    def __init__(self, calibration: Calibration | None = TURNED) -> None:
        self.rig = camera_rig()
        assert self.rig.camera is not None
        self.encoders = Encoders("nobody", (0, 1))
        self.said = Said(Seen())
        self.node = CameraNode(self.rig, self.said, Interpreter(self.rig.camera, calibration), self.encoders)
        self.readings = Readings(list(self.rig.sensors.values()), sensor_readers(self.rig.sensors, Path()), MS)
        self.number = 0

    def show(self, seen: Seen, position: tuple[float, float] = (1e-3, 2e-3), speed: float = 0.0) -> None:
        self.number += 1
        self.said.seen = seen
        exposed_ns, arrived_ns = self.number * 33 * MS, self.number * 33 * MS + 50 * MS
        steps = np.arange(-20, 21)
        times = exposed_ns + steps * MS
        places = np.array(position) + np.column_stack([steps * 1e-3 * speed, 0.0 * steps])
        self.encoders.add(times, places, exposed_ns)
        image = Image(np.full((16, 16), self.number, np.uint8), self.number, -1, arrived_ns)
        frames = self.node.frames(image)
        for tick in range(33):
            self.readings.begin(arrived_ns + tick * MS)
            for frame in frames if tick == 0 else ():
                assert self.readings.take(frame._replace(timestamp_ns=arrived_ns)) is None
            self.readings.close()

    def value(self, name: str) -> float:
        return self.readings.values[list(self.rig.sensors).index(name)]

    def age(self, name: str) -> int:
        return self.readings.age[list(self.rig.sensors).index(name)]


def test_a_tip_where_it_should_be_and_a_cell_at_rest_read_zero() -> None:
    bench = Bench()
    for _ in range(3):
        bench.show(Seen(TIP, 1.0, Spot(400.0, 200.0), 200.0, 0.0, 0.0))
    assert [bench.value(name) for name in ("tip", "shift", "bolus")] == [0.0, 0.0, 0.0]
    assert not any(math.isnan(value) for value in bench.readings.values)
    assert bench.readings.strayed == [-1, -1, -1]


def test_what_moves_is_told_in_metres_in_the_direction_of_the_axes() -> None:
    interpreter = Interpreter(config := camera_config(), TURNED)
    first = interpreter.quantities(Seen(TIP, 1.0, Spot(400.0, 200.0), 200.0), (1e-3, 2e-3), 0.0)
    assert first["cell_x"] == pytest.approx(1e-3 - 40 * 2.5e-6)
    assert first["cell_y"] == pytest.approx(2e-3 - 80 * 2.5e-6)
    off = interpreter.quantities(Seen(Spot(323.0, 244.0), 1.0, Spot(406.0, 208.0), 200.0), (1e-3, 2e-3), 0.0)
    assert off["tip_error"] == pytest.approx(5 * 2.5e-6)
    assert off["tip_x"] == pytest.approx(1e-3 + 4 * 2.5e-6)
    assert off["cell_shift"] == pytest.approx(10 * 2.5e-6)
    full = interpreter.quantities(Seen(bolus=config.full_bolus / 2.5e-6**2, dimple=40.0), None, 0.0)
    assert full == {"bolus": pytest.approx(1.0), "dimple": pytest.approx(1e-4)}


def test_a_cell_that_goes_with_the_dish_has_not_shifted() -> None:
    interpreter = Interpreter(camera_config(), TURNED)
    for way in range(5):
        x = 1e-3 + way * 1e-5
        seen = Seen(TIP, 1.0, Spot(400.0, 200.0 - way * 4.0), 200.0)  # the axis moves the dish up the rows
        assert interpreter.quantities(seen, (x, 2e-3), 0.0)["cell_shift"] == pytest.approx(0.0, abs=1e-12)


def test_the_next_cell_is_held_against_its_own_first_place_once_the_axes_rest() -> None:
    interpreter = Interpreter(camera_config(), TURNED)
    seen = Seen(TIP, 1.0, Spot(330.0, 250.0), 200.0)
    assert "cell_shift" not in interpreter.quantities(seen, (1e-3, 2e-3), 0.02)
    assert interpreter.quantities(seen, (1e-3, 2e-3), 0.0)["cell_shift"] == 0.0
    assert "cell_shift" not in interpreter.quantities(seen, (2e-3, 2e-3), 0.02)
    assert interpreter.quantities(seen, (2.5e-3, 2e-3), 0.0)["cell_shift"] == 0.0
    rolled = seen._replace(cell=Spot(330.0, 258.0))
    assert interpreter.quantities(rolled, (2.5e-3, 2e-3), 0.0)["cell_shift"] == pytest.approx(2e-5)


def test_an_image_that_does_not_show_the_tip_is_sent_and_ages() -> None:
    bench = Bench()
    bench.show(Seen(Spot(324.0, 240.0), 1.0))
    assert bench.value("tip") == pytest.approx(1e-5)
    assert bench.age("tip") == 32
    bench.show(Seen(bolus=0.0))
    assert bench.value("tip") == pytest.approx(1e-5)
    assert bench.age("tip") == 65
    assert bench.age("bolus") == 32
    assert bench.readings.strayed == [-1, -1, -1]


def test_what_is_told_against_the_encoders_waits_for_a_control_process() -> None:
    bench = Bench()
    bench.encoders.add = lambda *_: None  # type: ignore[method-assign]
    bench.show(Seen(TIP, 1.0, Spot(400.0, 200.0), 200.0, 0.0, 0.0))
    assert math.isnan(bench.value("tip"))
    assert bench.value("bolus") == 0.0


def test_positions_are_those_at_the_exposure_and_not_at_the_arrival() -> None:
    encoders = Encoders("nobody", (0, 1))
    times = np.arange(0, 500 * MS, MS)
    encoders.add(times, np.column_stack([times * 1e-11, 0.0 * times]), 500 * MS)
    place = encoders.at(250_500_000)
    assert place is not None
    assert place.position == pytest.approx((2.505e-3, 0.0))
    assert place.speed == pytest.approx(0.01)
    assert encoders.at(-1) is None
    assert encoders.at(600 * MS) is None
    encoders.add(times[:2] + 560 * MS, np.zeros((2, 2)), 560 * MS)
    assert encoders.at(530 * MS) is None  # 61 ms without a sample


def test_images_are_kept_under_the_number_and_the_instant_of_their_frames(tmp_path: Path) -> None:
    bench = Bench()
    bench.node = CameraNode(
        bench.rig, bench.said, Interpreter(camera_config(), TURNED), bench.encoders, KeptImages(tmp_path / "images")
    )
    for _ in range(3):
        bench.show(Seen(TIP, 1.0))
    again = Image(np.full((16, 16), 3, np.uint8), 3, -1, 400 * MS)
    assert bench.node.frames(again) == [], "an old image is not kept twice"
    files = sorted((tmp_path / "images").iterdir())
    assert [path.name for path in files] == [f"{n:08d}-{(n + 1) * 33 * MS}.npy" for n in range(3)]
    assert [int(np.load(path)[0, 0]) for path in files] == [1, 2, 3]
    assert bench.readings.newest[0].sequence == 2
    assert Folder(tmp_path / "images").read() is not None
    with pytest.raises(FileExistsError, match="00000000"):
        KeptImages(tmp_path / "images").keep(np.zeros((2, 2)), 0, 33 * MS)


def test_the_same_image_again_sends_nothing() -> None:
    bench = Bench()
    image = Image(np.zeros((16, 16), np.uint8), 1, -1, 50 * MS)
    assert len(bench.node.frames(image)) == 3
    assert bench.node.frames(image) == []
    assert (bench.node.counts.images, bench.node.exposures.old) == (1, 1)


# detectors of users, and what cannot be -------------------------------------------------------------------------------

MINE = """
import hil
import numpy

class Mine(hil.Features):
    def __init__(self, shade=0):
        self.shade = shade

    def of(self, image, stamp):
        if self.shade > 9:
            return 3
        rows, columns = numpy.nonzero(image == self.shade)
        return hil.Seen(tip=hil.Spot(columns.mean(), rows.mean()))
"""


def users(tmp_path: Path, text: str, *more: str) -> Any:
    (tmp_path / "mine.py").write_text(text)
    (tmp_path / "rig.toml").write_text(RIG.read_text())
    return load_rig(tmp_path / "rig.toml", [*CAMERA, "camera.detector=./mine.py:Mine", *more]).camera


def test_a_detector_of_your_own(tmp_path: Path) -> None:
    detector = detector_of(users(tmp_path, MINE, "camera.parameters={shade=7}"))
    image = np.zeros((16, 16), np.uint8)
    image[3, 5] = 7
    assert detector.of(image, 0).tip == (5.0, 3.0)


@pytest.mark.parametrize(
    ("text", "more", "words"),
    [
        (MINE, "camera.parameters={shape=1}", r"camera\.parameters\.shape: .* has shade"),
        (MINE.replace("def of", "def off"), "camera.parameters={}", "abstract method of"),
        (MINE.replace("self.shade = shade", "1 / 0"), "camera.parameters={}", r"mine\.py:\d+: ZeroDivisionError"),
    ],
)
def test_a_detector_that_cannot_be_made_is_refused_by_name(tmp_path: Path, text: str, more: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        detector_of(users(tmp_path, text, more))


@pytest.mark.parametrize(
    ("shade", "words"),
    [(10, r"answered int, expected hil\.Seen"), (5, r"camera\.detector = .*mine\.py:12: AttributeError")],
)
def test_a_detector_that_fails_is_told_with_its_line(tmp_path: Path, shade: int, words: str) -> None:
    bench = Bench()
    detector = detector_of(
        users(tmp_path, MINE.replace("numpy.nonzero", "numpy.nowhere"), f"camera.parameters={{shade={shade}}}")
    )
    node = CameraNode(bench.rig, detector, Interpreter(camera_config(), TURNED), None)
    with pytest.raises(CameraError, match=words):
        node.frames(Image(np.ones((16, 16), np.uint8), 1, -1, 50 * MS))


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("camera.sends={tip_error='tap'}", r"camera\.sends\.tip_error = 'tap': no such sensor; .* tip, shift, bolus"),
        ("camera.sends={bolus='tip'}", r"camera\.sends\.bolus: sensors\.tip\.unit = 'm', expected '1'"),
        ("camera.sends={tip_error='tip', tip_x='tip'}", "a sensor twice"),
        ("camera.sends={tip_z='tip'}", "needs depth_per_blur"),
        ("camera.sends={}", r"camera\.sends"),
        ("camera.axes=['x', 'x']", "an axis twice"),
        ("camera.axes=['x', 'w']", "no axis 'w'; the axes are x, y, z, theta"),
        ("camera.detector=pipete-and-cell", "nearest is pipette-and-cell"),
        ("camera.pixel=0.0", r"camera\.pixel"),
    ],
)
def test_a_camera_that_cannot_be_is_refused_by_key(override: str, words: str) -> None:
    with pytest.raises(RigError, match=words):
        camera_rig(override)


@pytest.mark.parametrize(
    "pixels", [np.zeros((16,)), np.zeros((16, 16, 2)), np.zeros((4, 900)), np.zeros((16, 16), bool)]
)  # fmt: skip
def test_what_is_no_image_is_refused(pixels: Pixels) -> None:
    with pytest.raises(CameraError, match="expected"):
        grey(pixels)


def test_of_colours_the_mean_counts() -> None:
    assert grey(np.full((16, 20, 4), (10, 20, 60, 255), np.uint8))[0, 0] == 30.0


def camera_config() -> CameraConfig:
    found = camera_rig().camera
    assert found is not None
    return found
