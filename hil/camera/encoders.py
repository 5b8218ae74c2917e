"""Where the axes were when an image was exposed, from the ring of the control process on this machine."""

import contextlib
import math
import time
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.live.mapped_file import Closing
from hil.live.ring import RingError, RingReader
from hil.live.runtime_paths import files_of_rigs

_FIELDS: Final = ("stamp_ns", "position")
_KEPT_NS: Final = 1_000_000_000  # of the past
_MOST: Final = 4096  # records a look
_SEARCH_NS: Final = 250_000_000
_NEAR_NS: Final = 20_000_000  # between an exposure and the samples around it
_SPAN_NS: Final = 10_000_000  # over which speed is told


class Place(NamedTuple):
    """Of the two axes of the image. position: m. speed: m/s, the way of both together."""

    position: tuple[float, float]
    speed: float


class Encoders(Closing):
    """Follows the control process of a rig, and whichever comes after it. axes: places of the two in the rig file."""

    def __init__(self, rig: str, axes: tuple[int, int]) -> None:
        self._rig, self._axes = rig, list(axes)
        self._reader: RingReader | None = None
        self._searched_ns = -_SEARCH_NS
        self._times: NDArray[np.int64] = np.empty((0, 2), np.int64)
        self._places: NDArray[np.float64] = np.empty((0, 2))

    def at(self, instant_ns: int) -> Place | None:
        """At that instant, between two samples by a straight line; None where there are none around it."""
        self._follow()
        found = [self._axis_at(axis, instant_ns) for axis in range(2)]
        first, second = found
        if first is None or second is None:
            return None
        return Place((first[0], second[0]), math.hypot(first[1], second[1]))

    def _axis_at(self, axis: int, instant_ns: int) -> tuple[float, float] | None:
        """Position and speed of one axis, whose samples have stamps of their own."""
        times, places = self._times[:, axis], self._places[:, axis]
        behind = int(np.searchsorted(times, instant_ns))
        if not 0 < behind < len(times) or times[behind] - times[behind - 1] > _NEAR_NS:
            return None
        ends = np.interp([instant_ns - _SPAN_NS, instant_ns, instant_ns + _SPAN_NS], times, places)
        return float(ends[1]), float(max(abs(ends[2] - ends[1]), abs(ends[1] - ends[0])) / (_SPAN_NS * 1e-9))

    def _follow(self) -> None:
        now_ns = time.monotonic_ns()
        if now_ns - self._searched_ns >= _SEARCH_NS:
            self._searched_ns = now_ns
            self._search()
        if self._reader is None:
            return
        reader = self._reader
        reader.next = max(reader.next, reader.written - _MOST)
        records = reader.read(_MOST, _FIELDS).records
        self.add(records["stamp_ns"][:, self._axes], records["position"][:, self._axes], now_ns)

    def add(self, times: NDArray[np.int64], places: NDArray[np.float64], now_ns: int) -> None:
        """Samples of both axes, shape (samples, 2), later than all before; those older than a second are forgotten."""
        times, places = np.concatenate([self._times, times]), np.concatenate([self._places, places])
        recent = (times > now_ns - _KEPT_NS).all(axis=1)
        self._times, self._places = times[recent], places[recent]

    def _search(self) -> None:
        reader = self._reader
        if reader is not None and not reader.replaced and reader.writer_alive:
            return
        for path in files_of_rigs("ring", self._rig):
            with contextlib.suppress(RingError):
                found = RingReader(path)
                if found.writer_alive:
                    self.close()
                    self._reader = found
                    self._times, self._places = self._times[:0], self._places[:0]
                    found.next = max(found.written - 1, 0)
                    return
                found.close()

    def close(self) -> None:
        """Let go of the ring; idempotent."""
        if self._reader is not None:
            self._reader.close()
            self._reader = None
