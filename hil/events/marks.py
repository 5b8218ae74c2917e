"""Which events a picture of a run shows, and where."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.cli.marks import Mark
from hil.events.event import Event
from hil.events.table import Kind

MOST = 200  # the gravest first
_STYLES = {
    Kind.FAULT_LATCHED: ("red", "-"),
    Kind.FAULT_SEEN: ("darkorange", "--"),
    Kind.FAULT_CLEARED: ("green", "-"),
    Kind.STATE: ("grey", ":"),
    Kind.BUS: ("purple", "--"),
    Kind.LAW: ("red", "--"),
    Kind.DRIVE: ("purple", "--"),
    Kind.ACCURACY_LOST: ("darkorange", ":"),
    Kind.RIG_FILE: ("purple", ":"),
    Kind.TICKS_LOST: ("brown", ":"),
    Kind.RECORDS_LOST: ("brown", "--"),
}
_WORDED = (Kind.FAULT_LATCHED, Kind.ACCURACY_LOST)
_GRAVITY = list(_STYLES)


def marks_of(events: Sequence[Event], index: NDArray[np.int64]) -> list[Mark]:
    """In order of time. index: of the ticks in the run's columns, ascending."""
    shown = [event for event in events if event.kind in _STYLES and event.tick >= 0]
    if len(shown) > MOST:
        kept = sorted(range(len(shown)), key=lambda n: (_GRAVITY.index(shown[n].kind), n))[:MOST]
        shown = [shown[n] for n in sorted(kept)]
    places = np.searchsorted(index, [event.tick for event in shown]).tolist()
    return [
        Mark(place, event.name, event.line, event.axis, *_STYLES[event.kind], event.kind in _WORDED)
        for place, event in zip(places, shown, strict=True)
    ]
