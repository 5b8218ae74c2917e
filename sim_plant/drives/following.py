"""Following error of a drive in cyclic synchronous position: 6062h, 6065h, 6066h, 60F4h (CiA 402-2)."""

from typing import NamedTuple

from sim_plant.drives.object_dictionary import ObjectDictionary, key_of

_WINDOW, _TIMEOUT = key_of(0x6065), key_of(0x6066)
_NO_WINDOW = 0xFFFFFFFF  # 6065h: not watched, as without the object


class Demand(NamedTuple):
    """A position asked for, counts: on a straight line from one SYNC to the next, then at the target."""

    start: float
    target: float
    since_ns: int
    until_ns: int

    def at(self, now_ns: int) -> float:
        """The position demand value, 6062h."""
        if now_ns >= self.until_ns:
            return self.target
        return self.start + (self.target - self.start) * (now_ns - self.since_ns) / (self.until_ns - self.since_ns)


class FollowingError:
    """error: demand less actual position, counts. exceeded: beyond 6065h for longer than 6066h, until `clear`."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self.clear()

    def clear(self) -> None:
        """Nothing is demanded."""
        self.error = 0
        self.exceeded = False
        self._since_ns: int | None = None

    def look(self, demand: float, actual: float, now_ns: int) -> bool:
        """Whether the error is too large since this look. demand, actual: counts."""
        self.error = round(demand - actual)
        window = self._dictionary.number(_WINDOW, _NO_WINDOW)
        if window == _NO_WINDOW or abs(self.error) <= window:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = now_ns
        late = now_ns - self._since_ns >= self._dictionary.number(_TIMEOUT) * 1_000_000
        begins, self.exceeded = late and not self.exceeded, self.exceeded or late
        return begins
