"""What goes over a bus, identifier by identifier: the figures behind `hil bus view`."""

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

from drivers.bus.error_frames import describe_error
from drivers.frame import BRS, ERROR, EXTENDED, EXTENDED_MASK, FD, REMOTE, STANDARD_MASK, Frame
from drivers.frame_length import INTERMISSION, frame_bits

WINDOW_S = 1.0  # over which rate and load are taken


class Row(NamedTuple):
    """One identifier. rate: frames per second; age, s: since its last frame; frame: that frame."""

    can_id: int
    count: int  # type: ignore[assignment]  # tuple has a method of that name
    rate: float
    age: float
    frame: Frame


class BusStatistics:
    """Counts frames; times in seconds on one clock of the caller's choice.

    received: data frames in all. errors: error frames by what they say. load: of the bus, 0 to 1, in the last complete
    window; without bit timing and error frames, from the exact lengths of the frames seen.
    """

    def __init__(self, bitrate: int, data_bitrate: int, now: float) -> None:
        """Bit rates in bit/s, for the load."""
        self._bit_s, self._data_bit_s = 1.0 / bitrate, 1.0 / data_bitrate
        self._last: dict[int, tuple[Frame, float]] = {}
        self._counts: Counter[int] = Counter()
        self._window: Counter[int] = Counter()
        self._rates: dict[int, float] = {}
        self._window_start = now
        self._busy = 0.0
        self.received = 0
        self.errors: Counter[str] = Counter()
        self.load = 0.0
        self.rate = 0.0

    def add(self, frame: Frame, at: float) -> None:
        """A frame that was seen at this time."""
        if frame.can_id & ERROR:
            self.errors[describe_error(frame.can_id, frame.data)] += 1
            return
        self.received += 1
        self._counts[frame.can_id] += 1
        self._window[frame.can_id] += 1
        self._last[frame.can_id] = frame, at
        self._busy += self.duration(frame)

    def duration(self, frame: Frame) -> float:
        """How long the frame occupies the bus, its intermission included, s."""
        nominal, data = frame_bits(frame)
        return (nominal + INTERMISSION) * self._bit_s + data * self._data_bit_s

    def roll(self, now: float, at_least: float = WINDOW_S) -> None:
        """Close the window when it is `at_least` so long: rates and load are those of the time since it was opened."""
        elapsed = now - self._window_start
        if elapsed < at_least:
            return
        self._rates = {can_id: count / elapsed for can_id, count in self._window.items()}
        self.rate = self._window.total() / elapsed
        self.load = self._busy / elapsed
        self._window.clear()
        self._busy = 0.0
        self._window_start = now

    def rows(self, now: float) -> list[Row]:
        """All identifiers seen, in the order of arbitration among equals: lowest first."""
        return [
            Row(can_id, self._counts[can_id], self._rates.get(can_id, 0.0), now - at, frame)
            for can_id, (frame, at) in sorted(self._last.items())
        ]


def identifier(can_id: int) -> str:
    """An identifier as candump writes it: three or eight hexadecimal digits."""
    return f"{can_id & EXTENDED_MASK:08X}" if can_id & EXTENDED else f"{can_id & STANDARD_MASK:03X}"


def kind(frame: Frame) -> str:
    """classic, remote, FD, or FD with bit-rate switch."""
    if frame.can_id & REMOTE:
        return "remote"
    if not frame.flags & FD:
        return "classic"
    return "FD BRS" if frame.flags & BRS else "FD"


def total(errors: Iterable[tuple[str, int]]) -> str:
    """Error counts in one line."""
    return "; ".join(f"{text}: {count}" for text, count in errors) or "none"
