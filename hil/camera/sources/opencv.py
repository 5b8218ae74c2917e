"""Images from OpenCV: a camera of this computer, a film, or whatever else VideoCapture opens."""

import time

import numpy as np

from hil.camera.contract import CameraError, Image
from hil.camera.sources.pace import Pace
from hil.rig.extras import install_command


class OpenCv:
    """which: a camera's number, or a film, whose images come 30 a second. is_camera: it is one. Raises CameraError."""

    def __init__(self, which: str) -> None:
        try:
            import cv2
        except ImportError as error:
            raise CameraError(f"--source opencv needs OpenCV: {install_command('opencv')}") from error
        self._cv2, self._which = cv2, which
        self.is_camera = which.isdecimal()
        self._capture = cv2.VideoCapture(int(which) if self.is_camera else which)
        if not self._capture.isOpened():
            self._capture.release()
            raise CameraError(f"--source opencv:{which}: OpenCV cannot open it; another program may have it open")
        if self.is_camera:
            self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        self._number = 0
        self._pace = Pace()

    def read(self) -> Image | None:
        """The next one. A camera's stamp is its driver's, where OpenCV tells it."""
        if not self.is_camera:
            self._pace.wait()
        read, pixels = self._capture.read()
        if not read:
            if self.is_camera:
                raise CameraError(f"--source opencv:{self._which}: the camera sends no images any more")
            raise EOFError
        arrived_ns = time.monotonic_ns()
        self._number += 1
        stamp_ns = round(self._capture.get(self._cv2.CAP_PROP_POS_MSEC) * 1e6) if self.is_camera else 0
        return Image(np.asarray(pixels), self._number, stamp_ns if stamp_ns > 0 else -1, arrived_ns)

    def close(self) -> None:
        """Let go of it."""
        self._capture.release()
