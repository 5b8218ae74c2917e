"""Images from files, 30 a second, in the order of their names."""

import time
from pathlib import Path

import numpy as np

from drivers.base.text_file import words_of
from hil.camera.contract import CameraError, Image, Pixels
from hil.camera.sources.pace import Pace

KINDS = (".npy", ".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")


class Folder:
    """Raises CameraError where there is no such folder, or no image in it."""

    def __init__(self, folder: Path) -> None:
        try:
            self._files = sorted(path for path in folder.iterdir() if path.suffix.lower() in KINDS)
        except OSError as error:
            raise CameraError(f"{folder}: {words_of(error)}") from None
        if not self._files:
            raise CameraError(f"{folder}: no image in it; expected files that end in {', '.join(KINDS)}")
        self._next = 0
        self._pace = Pace()

    def read(self) -> Image | None:
        """The next file. Raises EOFError behind the last one, CameraError for one that is no image."""
        if self._next == len(self._files):
            raise EOFError
        self._pace.wait()
        path, number = self._files[self._next], self._next
        self._next += 1
        return Image(_pixels(path), number, -1, time.monotonic_ns())

    def close(self) -> None:
        """There is nothing to let go of."""


def _pixels(path: Path) -> Pixels:
    try:
        if path.suffix.lower() == ".npy":
            return np.asarray(np.load(path, allow_pickle=False))
        from matplotlib.image import imread

        return np.asarray(imread(path))
    except Exception as error:  # each format's library fails in its own way
        raise CameraError(f"{path}: cannot be read as an image: {words_of(error)}") from None
