"""What a camera's process is made of: sources of images, and what makes features of them."""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[Any]


class CameraError(Exception):
    """A source that cannot be opened or has failed; the text says which, why, and what to do."""


class Image(NamedTuple):
    """One image. pixels: shape (height, width), integers or floats, brighter is greater. number: the source's own count
    of frames; -1: it has none. stamp_ns: of the camera's own clock; -1: it has none. arrived_ns: CLOCK_MONOTONIC.
    """

    pixels: Pixels
    number: int
    stamp_ns: int
    arrived_ns: int


class Source(Protocol):
    """Where images come from."""

    def read(self) -> Image | None:
        """The next image, awaited for at most about a second; None: none has come. Raises CameraError, EOFError at the
        end of a source that has one.
        """

    def close(self) -> None:
        """Let go of the camera."""


class Spot(NamedTuple):
    """A place in an image, px: column and row of its pixel, 0 the middle of the first."""

    column: float
    row: float


class Seen(NamedTuple):
    """What one image shows; None: it does not show it, or not surely.

    tip: end of the pipette. tip_blur: px, standard deviation of its edge. cell: middle of the cell. cell_radius,
    dimple: px. bolus: px^2.
    """

    tip: Spot | None = None
    tip_blur: float | None = None
    cell: Spot | None = None
    cell_radius: float | None = None
    dimple: float | None = None
    bolus: float | None = None


class Features(ABC):
    """What makes features of an image; for a detector of your own, `[camera] features = "./mine.py:Mine"`.

        class Mine(hil.Features):
            def of(self, image, stamp):
                row, column = numpy.unravel_index(image.argmin(), image.shape)
                return hil.Seen(tip=hil.Spot(column, row))

    Parameters are those of [camera.parameters].
    """

    def __init__(self, **parameters: Any) -> None:  # noqa: B027
        """Made once, before the first image."""

    @abstractmethod
    def of(self, image: Pixels, stamp: int) -> Seen:
        """The features of one image, shape (height, width), exposed at `stamp`, ns of CLOCK_MONOTONIC."""


def grey(pixels: Pixels) -> Pixels:
    """An image of one value a pixel; of colours their mean. Raises CameraError for what is no image."""
    if pixels.ndim == 3 and pixels.shape[2] in (1, 3, 4):
        pixels = pixels[:, :, : min(pixels.shape[2], 3)].mean(axis=2)
    if pixels.ndim != 2 or min(pixels.shape) < 16 or pixels.dtype.kind not in "uif":
        raise CameraError(f"an image of shape {pixels.shape} and type {pixels.dtype}: expected (height, width), 16 or "
                          "more each, of numbers")  # fmt: skip
    return np.asarray(pixels)
