"""Where images come from: files, a scene that an emulator shows, a queue of which the newest counts."""

import os
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from hil.camera.contract import CameraError, Image
from hil.camera.sources import open_source
from hil.camera.sources.drawn import Drawn, optics_of
from hil.camera.sources.latest import Latest
from hil.live.runtime_paths import runtime_paths
from hil.virtual.emulate import emulated_stage, without_camera
from sim_plant.nodes.picture import Optics, Scene, picture
from sim_plant.scene_page import ScenePage, SceneReader, scene_of
from tests.camera.rigs import RIG, camera_rig

SCENE = Scene((1e-3, -2e-3, 3e-3), 1e-4, (0.9e-3, -2.1e-3), 0.4e-3, 5e-5, 0.75, 12)


@pytest.fixture
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HIL_RUNTIME_DIR", str(tmp_path))
    os.chmod(tmp_path, 0o700)
    return tmp_path


def test_a_folder_gives_its_images_in_order_and_ends(tmp_path: Path) -> None:
    drawn = picture(Optics(width=64, height=48), SCENE, 1)
    np.save(tmp_path / "b.npy", drawn)
    np.save(tmp_path / "a.npy", drawn + 1)
    (tmp_path / "notes.txt").write_text("no image")
    source = open_source(f"folder:{tmp_path}", camera_rig())
    first, second = source.read(), source.read()
    assert first is not None
    assert second is not None
    assert (first.number, second.number) == (0, 1)
    assert (first.pixels == drawn + 1).all()
    assert (second.pixels == drawn).all()
    assert second.arrived_ns > first.arrived_ns
    with pytest.raises(EOFError):
        source.read()


def test_a_png_is_read(tmp_path: Path) -> None:
    from matplotlib.image import imsave

    drawn = picture(Optics(width=64, height=48), SCENE, 1)
    imsave(tmp_path / "a.png", drawn, cmap="gray", vmin=0, vmax=255)
    image = open_source(f"folder:{tmp_path}", camera_rig()).read()
    assert image is not None
    assert np.abs(255 * image.pixels[:, :, 0] - drawn).max() < 1.5


def test_a_file_that_is_no_image_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_text("no image")
    with pytest.raises(CameraError, match=r"a\.png: cannot be read as an image"):
        open_source(f"folder:{tmp_path}", camera_rig()).read()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("folder:/nowhere", "/nowhere: No such file"),
        ("folder:", "expected drawn: of an emulated rig"),
        ("webcam", "'webcam': expected drawn"),
        ("drawn", "no emulated stage of microscope-ideal shows its scene"),
    ],
)
def test_a_source_that_is_not_there_is_refused_in_words(runtime: Path, words: str, told: str) -> None:
    with pytest.raises(CameraError, match=told):
        open_source(words, camera_rig())


def test_a_folder_without_images_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CameraError, match=r"no image in it; expected files that end in \.npy"):
        open_source(f"folder:{tmp_path}", camera_rig())


# scenes ---------------------------------------------------------------------------------------------------------------


def test_a_scene_is_read_as_it_was_written(tmp_path: Path) -> None:
    page = ScenePage(tmp_path / "scene")
    reader = SceneReader(tmp_path / "scene")
    with pytest.raises(ValueError, match="no whole scene"):
        reader.read()
    page.write(SCENE, 17)
    assert reader.read() == (SCENE, 17)
    page.write(SCENE._replace(cell=None), 18)
    assert reader.read() == (SCENE._replace(cell=None), 18)
    reader.close()
    page.close()


def test_a_scene_is_never_half_of_two(tmp_path: Path) -> None:
    page, ended = ScenePage(tmp_path / "scene"), threading.Event()
    page.write(Scene((0.0, 0.0, 0.0)), 0)

    def write() -> None:
        number = 0
        while not ended.is_set():
            number += 1
            page.write(
                Scene((number, number, number), number, (number, number), number, number, number, number), number
            )

    writer = threading.Thread(target=write)
    writer.start()
    reader = SceneReader(tmp_path / "scene")
    try:
        for _ in range(300):
            scene, now_ns = reader.read()
            assert now_ns == 0 or {*scene.tip, scene.missing, scene.radius, scene.bolus, scene.number} == {now_ns}
    finally:
        ended.set()
        writer.join()
        reader.close()
        page.close()


def test_the_emulated_stage_without_its_camera_shows_the_scene_instead() -> None:
    rig = camera_rig("plant.initial_position=[0.1e-3, 0.05e-3, -0.003, 0.0]")
    stage = emulated_stage(without_camera(rig), RIG.parent, 0)
    assert not stage.sensors
    assert len(emulated_stage(rig, RIG.parent, 0).sensors) == 3
    scene = scene_of(stage, (0, 1, 2))
    assert scene.tip == pytest.approx((0.1e-3, 0.05e-3, -0.003))
    assert scene.cell is None  # no time has passed yet


def test_drawn_images_are_of_the_shown_scene_and_of_new_ones_alone(runtime: Path) -> None:
    rig = camera_rig()
    page = ScenePage(runtime_paths(rig.name).scene)
    page.write(SCENE, 5)
    source = Drawn(rig)
    image = source.read()
    assert image is not None
    assert image.stamp_ns == 5
    assert (image.pixels == picture(optics_of(rig), SCENE, 1)).all()
    assert source.read() is None
    source.close()
    page.close()


class Queue:
    """A camera that hands out numbered images as fast as they are taken, then breaks."""

    def __init__(self, count: int) -> None:
        self.count, self.number = count, 0
        self.go = threading.Event()

    def read(self) -> Image:
        self.number += 1
        if self.number > self.count:
            raise CameraError("unplugged")
        if self.number > 1:
            self.go.wait(10.0)
        return Image(np.zeros((16, 16)), self.number, -1, self.number)

    def close(self) -> None:
        self.go.set()


def test_of_queued_images_the_newest_counts_and_a_failure_is_told_after_it() -> None:
    queue = Queue(50)
    latest = Latest(queue)
    assert (first := latest.read()) is not None
    assert first.number == 1
    queue.go.set()
    latest._thread.join()
    assert (last := latest.read()) is not None
    assert last.number == 50
    with pytest.raises(CameraError, match="unplugged"):
        latest.read()
    latest.close()


# the libraries of others; where they are not installed, their absence is told -----------------------------------------


def test_without_opencv_the_command_that_installs_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(CameraError, match=r"pip install 'hil\[opencv\]'"):
        open_source("opencv:0", camera_rig())


def test_without_pymmcore_the_command_that_installs_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymmcore_plus", None)
    with pytest.raises(CameraError, match=r"pip install 'hil\[micro-manager\]'"):
        open_source("micro-manager:lab.cfg", camera_rig())
