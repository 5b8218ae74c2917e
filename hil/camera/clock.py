"""When an image was exposed, and whether it is a new one.

A camera's own clock shows how images follow one another; how far it is from the host's, the image that came soonest
tells. A delay that every image has is the stated latency. Without a stamp of the camera the arrival counts.
"""

from typing import Final
from zlib import crc32

import numpy as np

from hil.camera.contract import Image

_DRIFT: Final = 100e-6  # that two clocks can drift apart, s/s
_RESTARTED: Final = 8  # images in a row with a number or a stamp that was there before: the camera begins anew


class Exposures:
    """latency_ns: from the middle of an exposure to its image's arrival, of the image that comes soonest.

    old: images that had been there before: their number or stamp does not grow, or their pixels are the last one's.
    """

    def __init__(self, latency_ns: int) -> None:
        self._latency_ns = latency_ns
        self._offset_ns: int | None = None
        self._last = Image(np.empty(0), -1, -1, 0)
        self._digest = -1
        self._behind = 0
        self.old = 0

    def of(self, image: Image) -> int | None:
        """Instant of the exposure, CLOCK_MONOTONIC, ns; None for an image that is not new."""
        digest = crc32(np.ascontiguousarray(image.pixels).data)
        grows = _grows(image.number, self._last.number) and _grows(image.stamp_ns, self._last.stamp_ns)
        repeats = digest == self._digest
        self._behind = 0 if grows else self._behind + 1
        if repeats or (not grows and self._behind < _RESTARTED):
            self.old += 1
            return None
        if not grows:
            self._offset_ns, self._behind = None, 0
        passed_ns = image.arrived_ns - self._last.arrived_ns
        self._last, self._digest = image, digest
        if image.stamp_ns < 0:
            return image.arrived_ns - self._latency_ns
        offset_ns = image.arrived_ns - image.stamp_ns
        if self._offset_ns is not None:
            offset_ns = min(offset_ns, self._offset_ns + round(_DRIFT * passed_ns))
        self._offset_ns = offset_ns
        return image.stamp_ns + offset_ns - self._latency_ns


def _grows(value: int, last: int) -> bool:
    """Also where there is none."""
    return value < 0 or last < 0 or value > last
