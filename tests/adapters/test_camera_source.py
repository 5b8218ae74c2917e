"""The source of images that is Micro-Manager: a camera written in Python, in a core of pymmcore-plus."""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from pymmcore_plus.experimental.unicore import SimpleCameraDevice, UniMMCore

from hil.camera.clock import Exposures
from hil.camera.sources.micro_manager import MicroManager


class Counting(SimpleCameraDevice):
    """Every image has the number of the image as its shade."""

    shots = 0

    def sensor_shape(self) -> tuple[int, int]:
        return 24, 32

    def dtype(self) -> type:
        return np.uint8

    def get_exposure(self) -> float:
        return 5.0

    def set_exposure(self, exposure: float) -> None: ...

    def snap(self, buffer: np.ndarray) -> Mapping[str, Any]:
        time.sleep(0.005)
        self.shots += 1
        buffer[:] = self.shots % 251
        return {}


def test_each_image_of_the_running_camera_is_told_once_and_is_the_newest() -> None:
    core = UniMMCore()
    core.loadPyDevice("Camera", Counting())
    core.initializeDevice("Camera")
    core.setCameraDevice("Camera")
    source, exposures = MicroManager("", core), Exposures(0)
    images = [source.read() for _ in range(10)]
    source.close()
    found = [image for image in images if image is not None]
    assert len(found) == 10
    assert all(image.pixels.shape == (24, 32) for image in found)
    shades = [int(image.pixels[0, 0]) for image in found]
    assert shades == sorted(set(shades))
    assert all(exposures.of(image) is not None for image in found)
    assert all(image.number >= 0 and image.stamp_ns >= 0 for image in found)
    assert not core.isSequenceRunning()
