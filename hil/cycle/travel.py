"""The travel of an axis as the fault monitor holds it: wider for the way back of an axis that rests beyond its end."""


class Travel:
    """low, high: where the axis may be now, m (rad). wide: it is on its way back from beyond an end."""

    __slots__ = ("_high", "_low", "_room", "high", "low", "wide")

    def __init__(self, low: float, high: float, room: float) -> None:
        """low, high: its ends. room: how far an axis on its way back may go outwards again."""
        self._low, self._high, self._room = low, high, room
        self.low, self.high, self.wide = low, high, False

    def restart(self) -> None:
        """The travel between its ends."""
        self.low, self.high, self.wide = self._low, self._high, False

    def enclose(self, low: float, high: float) -> None:
        """While it homes, its ends mean nothing: only so far, m (rad), until the next `restart`."""
        self.low, self.high, self.wide = low, high, False

    def begin_at(self, position: float) -> None:
        """The axis rests there, and is to be brought back where that is beyond an end."""
        self.low = min(self._low, position - self._room) if position < self._low else self._low
        self.high = max(self._high, position + self._room) if position > self._high else self._high
        self.wide = not self._low <= position <= self._high

    def follow(self, position: float) -> None:
        """What the axis has come back it does not get again. To be called where it is wide."""
        self.low = min(self._low, max(self.low, position - self._room))
        self.high = max(self._high, min(self.high, position + self._room))
        self.wide = self.low < self._low or self.high > self._high
