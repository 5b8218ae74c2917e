"""A storm of events is bounded, and counted: of each second's alike events the first few are told one by one, and one
more, at the second's end, stands for all the others (`times`).
"""

from collections.abc import Iterable
from typing import Final

from hil.events.event import Event
from hil.events.table import Kind

TOLD: Final = 3  # alike events told one by one
TOLD_OF: Final = {Kind.TICK_LATE: 1, Kind.TICKS_LOST: 1}  # a busy machine has them in every second

_COUNTED: Final = (Kind.FAULT_SEEN, Kind.FAULT_LATCHED)  # their causes hold counts and ticks: alike without


class _Tally:
    """Of one sort of event: how many were told, and how many the last one stands for."""

    def __init__(self) -> None:
        self.told = 0
        self.untold = 0
        self.last: Event | None = None


class Tallies:
    """The events of the present second, by what makes them alike."""

    def __init__(self) -> None:
        self._window = 0
        self._tallies: dict[tuple[Kind, str, str, str], _Tally] = {}

    def admit(self, events: Iterable[Event]) -> list[Event]:
        """Those of them to be told now; the others are counted."""
        admitted = []
        for event in events:
            cause = "" if event.kind in _COUNTED else event.cause
            tally = self._tallies.setdefault((event.kind, event.name, event.axis, cause), _Tally())
            if tally.told < TOLD_OF.get(event.kind, TOLD):
                tally.told += 1
                admitted.append(event)
            else:
                tally.untold += event.times
                tally.last = event
        return admitted

    def turn(self, window: int) -> list[Event]:
        """That second begins; what the last one has left to tell."""
        if window == self._window:
            return []
        self._window = window
        return self.end()

    def end(self) -> list[Event]:
        """What is left to tell."""
        rest = [tally.last._replace(times=tally.untold) for tally in self._tallies.values() if tally.last]
        self._tallies.clear()
        return rest
