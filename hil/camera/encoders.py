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

_FIELDS: Final = ("scheduled_ns", "age_ticks", "position")
_KEPT_NS: Final = 1_000_000_000  # of the past
_MOST: Final = 4096  # records a look
_SEARCH_NS: Final = 250_000_000
_NEAR_NS: Final = 50_000_000  # between an exposure and the samples around it
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
        self._times: NDArray[np.int64] = np.empty(0, np.int64)
        self._places: NDArray[np.float64] = np.empty((0, 2))

    def at(self, instant_ns: int) -> Place | None:
        """At that instant, between two samples by a straight line; None where there are none around it."""
        self._follow()
        times, places = self._times, self._places
        behind = int(np.searchsorted(times, instant_ns))
        if not 0 < behind < len(times) or times[behind] - times[behind - 1] > _NEAR_NS:
            return None
        instants = [instant_ns - _SPAN_NS, instant_ns, instant_ns + _SPAN_NS]
        x, y = (np.interp(instants, times, places[:, axis]) for axis in range(2))
        speed = max(math.hypot(*np.diff((x, y))[:, step]) for step in range(2)) / (_SPAN_NS * 1e-9)
        return Place((float(x[1]), float(y[1])), float(speed))

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
        records = records[(records["age_ticks"][:, self._axes] == 0).all(axis=1)]
        # The drives sample at the command of the tick before
        self.add(records["scheduled_ns"] - reader.period_ns, records["position"][:, self._axes], now_ns)

    def add(self, times: NDArray[np.int64], places: NDArray[np.float64], now_ns: int) -> None:
        """Samples later than all before; those older than a second are forgotten. times: ns, shape (samples,).
        places: m, shape (samples, 2).
        """
        times, places = np.concatenate([self._times, times]), np.concatenate([self._places, places])
        recent = times > now_ns - _KEPT_NS
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
