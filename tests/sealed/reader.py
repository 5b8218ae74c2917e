"""Somebody who was not there and has the run's events alone: what does he say happened, and to which axis?"""

from pathlib import Path
from typing import Final, NamedTuple

from hil.events.event import Event
from hil.events.table import Kind, Severity
from hil.runs.events import of_recording

_TELLING: Final = (Kind.FAULT_SEEN, Kind.FAULT_LATCHED, Kind.ACCURACY_LOST, Kind.BUS, Kind.DRIVE, Kind.LAW)


class Answer(NamedTuple):
    """line: the event that he goes by, as `hil events` prints it; "": nothing happened. at_s: of the first that told
    of anything. alarms: how many there were.
    """

    line: str = ""
    axis: str = ""
    at_s: float = 0.0
    alarms: int = 0


def read(folder: Path) -> Answer:
    """The latched fault, if there is one, else the first warning."""
    events, _ = of_recording(folder)
    return answer(events)


def answer(events: list[Event]) -> Answer:
    """The same of a list of events."""
    grave = [event for event in events if event.kind in _TELLING and event.severity <= Severity.WARNING]
    if not grave:
        return Answer()
    latched = [event for event in grave if event.kind is Kind.FAULT_LATCHED]
    chosen = (latched or grave)[0]
    return Answer(chosen.line, chosen.axis, grave[0].run_ns * 1e-9, len(grave))
