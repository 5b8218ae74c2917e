"""Touch probe 1 of an emulated CiA 402 drive, on the zero pulse of its encoder (CiA 402-2, 60B8h to 60BBh).

The pulse is high over one count from the index on. Its edges latch the drive's own position where they are, not where
the axis is when somebody looks. Bits 0 to 5 of 60B8h act; the probe's digital input and 60D0h are not wired, and touch
probe 2 is not there.
"""

from sim_plant.drives.object_dictionary import ObjectDictionary, key_of

FUNCTION, STATUS, RISING, FALLING = (key_of(index) for index in (0x60B8, 0x60B9, 0x60BA, 0x60BB))
ENABLE, CONTINUOUS, SOURCE, ZERO_PULSE, ON_RISING, ON_FALLING = 0x01, 0x02, 0x0C, 0x04, 0x10, 0x20  # of 60B8h
ENABLED, RISING_STORED, FALLING_STORED = 0x01, 0x02, 0x04  # of 60B9h


class TouchProbe:
    """index: count at which the pulse begins, in the drive's own counts; None: there is none, or it is broken."""

    def __init__(self, dictionary: ObjectDictionary, index: float | None) -> None:
        self.index = index
        self._dictionary = dictionary
        self._latched = {RISING: 0, FALLING: 0}
        self._stored = 0
        self._last: float | None = None
        dictionary.setters[FUNCTION] = self._take
        getters = {STATUS: self._status, RISING: lambda: self._latched[RISING], FALLING: lambda: self._latched[FALLING]}
        dictionary.getters |= {key: get for key, get in getters.items() if key in dictionary.entries}

    def follow(self, count: float) -> None:
        """The axis is there now, in counts with their fraction."""
        last, self._last = self._last, count
        function = self._dictionary.number(FUNCTION)
        if last is None or self.index is None or not function & ENABLE or function & SOURCE != ZERO_PULSE:
            return
        begins, ends = self.index, self.index + 1.0
        if last < begins <= count:
            self._edge(function, ON_RISING, begins)
        if last < ends <= count:
            self._edge(function, ON_FALLING, ends)
        if count < ends <= last:
            self._edge(function, ON_RISING, ends)
        if count < begins <= last:
            self._edge(function, ON_FALLING, begins)

    def _edge(self, function: int, edge: int, place: float) -> None:
        stored, key = (RISING_STORED, RISING) if edge == ON_RISING else (FALLING_STORED, FALLING)
        if function & edge and (function & CONTINUOUS or not self._stored & stored):
            self._latched[key] = round(place)
            self._stored |= stored

    def _status(self) -> int:
        return self._stored | (ENABLED if self._dictionary.number(FUNCTION) & ENABLE else 0)

    def _take(self, value: int) -> None:
        """Switched off it forgets what is stored; the positions stay readable."""
        if not value & ENABLE:
            self._stored = 0
