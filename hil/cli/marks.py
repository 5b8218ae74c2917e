"""Marks of events in pictures, without the library that draws them."""

from typing import NamedTuple


class Mark(NamedTuple):
    """An event over time. place: of its tick in the run's columns. label: short. line: all of it, as
    hil.events.event.Event.line has it. axis: its name, or empty for all. colour, style: as matplotlib names them.
    worded: told in words, too.
    """

    place: int
    label: str
    line: str
    axis: str
    colour: str
    style: str
    worded: bool
