"""Images from Micro-Manager, by pymmcore-plus, in this process: the camera of a configuration, free running.

Its ElapsedTime-ms is the time at which software took the image over, good to 1 to 10 ms (pymmcore-plus, issue 358). Its
newest image can be one that was there before (micro-manager, issue 520): ImageNumber tells.
"""

import time
from typing import Any

import numpy as np

from drivers.base.text_file import words_of
from hil.camera.contract import CameraError, Image
from hil.rig.extras import install_command

_WAIT_S = 1.0
_POLL_S = 0.002


class MicroManager:
    """configuration: file of Micro-Manager. core: in place of a new one. Raises CameraError."""

    def __init__(self, configuration: str, core: Any = None) -> None:
        if core is None:
            try:
                from pymmcore_plus import CMMCorePlus
            except ImportError as error:
                raise CameraError(
                    f"--source micro-manager needs pymmcore-plus: {install_command('micro-manager')}"
                ) from error
            core = CMMCorePlus()
        self._core, self._name = core, f"--source micro-manager:{configuration}"
        try:
            if configuration:
                core.loadSystemConfiguration(configuration)
            core.startContinuousSequenceAcquisition(0.0)
        except Exception as error:  # of its device adapters, each fails in its own way
            raise CameraError(f"{self._name}: {words_of(error)}") from error
        self._last = -1

    def read(self) -> Image | None:
        """The newest one, awaited until its number is another one."""
        until = time.monotonic() + _WAIT_S
        while time.monotonic() < until:
            image = self._newest()
            if image is not None and image.number != self._last:
                self._last = image.number
                return image
            time.sleep(_POLL_S)
        return None

    def _newest(self) -> Image | None:
        core = self._core
        try:
            if not core.getRemainingImageCount():
                return None
            pixels, tags = core.getLastImageAndMD()
        except Exception as error:
            raise CameraError(f"{self._name}: {words_of(error)}") from error
        arrived_ns = time.monotonic_ns()
        elapsed, number = tags.get("ElapsedTime-ms"), tags.get("ImageNumber")
        return Image(
            np.array(pixels),
            -1 if number is None else int(number),
            -1 if elapsed is None else round(float(elapsed) * 1e6),
            arrived_ns,
        )

    def close(self) -> None:
        """Stop the camera."""
        self._core.stopSequenceAcquisition()
