"""How one axis finds its position: from what is seen of it in each tick to where it goes next. It moves nothing.

    SEARCH     towards the switch, the index or the stop, until it is found
    BACK_OFF   away from it until the switch is open, and a little further
    LATCH      to it once more, slowly: where it is found now counts
    MOVE_TO    where the axis is wanted

Rules:
- Every step is one plan that ends at rest inside the way allowed. A plan that has ended without success is a failure,
  so that no step can last for ever.
- A switch counts as closed or open once SURE samples in a row say so; its place is that of the first of them.
- A switch that is closed at the start is backed off first: the axis stands on it.
- A stop has to be found twice at the same place. The index and the drive's word need no second look: the drive has
  counted from there, or latched its own position there. Where it latches, the axis begins once the drive looks out, and
  the drive is asked again once the axis rests at the end of its way.
"""

from enum import IntEnum
from typing import Final, NamedTuple

from drivers.protocols.finding import Search

HOMING_REQUIRED: Final = "HOMING_REQUIRED"  # in the refusal of who would move an axis that is yet to be homed
SURE: Final = 3  # samples in a row
CLEAR_S: Final = 0.05  # of the search's speed: how far the axis goes from what it has found, before it comes back


class Step(IntEnum):
    """Sub-states of HOMING, as records have them."""

    NONE = 0
    SEARCH = 1
    BACK_OFF = 2
    LATCH = 3
    MOVE_TO = 4


class Why(IntEnum):
    """Why an axis could not be homed; the words are HOMING_FAILED's."""

    NONE = 0
    NOT_FOUND = 1
    STAYS_CLOSED = 2
    BLOCKED = 3
    NOT_TOLD = 4
    BEYOND = 5
    TWO_PLACES = 6
    NO_ANSWER = 7
    ERROR = 8
    TOO_LONG = 9


class Terms(NamedTuple):
    """What an axis homes with. direction: -1 or 1. speed, latch_speed: m/s. way: m from where it stands. at: counts,
    position of what is found. move_to: m, or None. resolution: m a count. patience: ticks that a switch which is
    neither closed nor open is waited for. longest: ticks that a drive may take to home by itself.
    """

    by: str
    direction: int
    speed: float
    latch_speed: float
    way: float
    at: int
    move_to: float | None
    resolution: float
    patience: int
    longest: int = 0


class Seen(NamedTuple):
    """One axis in one tick. position: m. counts: the same as a number of counts. told: what the drive itself counts.
    fresh: a sample came. closed: its switch. homed: its drive says so. blocked: it pushes against something. ended: its
    plan. search: what its drive has been asked to find.
    """

    position: float
    counts: int
    told: int
    fresh: bool
    closed: bool
    homed: bool
    blocked: bool
    ended: bool
    search: Search = Search.NONE


class Go(NamedTuple):
    """Where the axis is to go next, m, and at which speed, m/s; None: to rest, wherever that is."""

    target: float | None
    speed: float


class AxisHoming:
    """step: what it does. why: what went wrong. done: it has been homed and stands where it is wanted. shift: counts by
    which its positions are to be moved.
    """

    def __init__(self, terms: Terms) -> None:
        self.terms = terms
        self._clear = CLEAR_S * terms.speed
        self.restart()

    def restart(self) -> None:
        """Nothing is known."""
        self.step, self.why, self.done, self.shift = Step.NONE, Why.NONE, False, 0
        self._start = self._edge = self._first = 0.0
        self._edge_counts = self._same = self._waited = 0
        self._closed = self._leaves = False

    @property
    def under_way(self) -> bool:
        """It has been told where to search."""
        return self.step is Step.SEARCH and self._leaves

    def begin(self, position: float) -> None:
        """From rest at `position`, m."""
        self.restart()
        self._start = position
        self.step = Step.SEARCH

    def advance(self, seen: Seen) -> Go | None:
        """One tick: where the axis is to go from now on; None: it goes on as it does."""
        if self.done or self.why is not Why.NONE:
            return None
        if self.step is Step.MOVE_TO:
            self.done = seen.ended
            return self._fail(Why.BLOCKED) if seen.blocked else None
        by = self.terms.by
        if by == "stop":
            return self._towards_stop(seen)
        if by in ("switch", "limit", "index") and seen.blocked:
            return self._fail(Why.BLOCKED)
        if by in ("switch", "limit"):
            return self._towards_switch(seen)
        return self._without_a_look(by, seen)

    def _without_a_look(self, by: str, seen: Seen) -> Go | None:
        """What needs no approach: where the axis stands, what its drive counts, what its encoder knows."""
        if by == "here":
            return self._found(seen.counts)
        if by == "absolute":
            return self._found(self.terms.at)
        if seen.search is Search.FAILED:
            return self._fail(Why.NO_ANSWER)
        if seen.search is Search.MISSED:
            return self._fail(Why.NOT_FOUND)
        if seen.search is Search.ERROR:
            return self._fail(Why.ERROR)
        if seen.homed:
            return self._found(seen.counts - seen.told)
        if by == "drive" and seen.search is not Search.NONE:
            return self._moved_by_its_drive(seen)
        if seen.search is not Search.NONE:  # NOT_FOUND is what the drive says once the axis rests
            return self._search(seen) if seen.search is Search.RUNNING and not self._leaves else None
        return self._search(seen) if by == "index" else self._fail(Why.NOT_TOLD)

    def _moved_by_its_drive(self, seen: Seen) -> Go | None:
        """Until it has homed, or is where it may not be."""
        self._waited += 1
        if abs(seen.position - self._start) > self.terms.way:
            return self._fail(Why.NOT_FOUND)
        return self._fail(Why.TOO_LONG) if self._waited > self.terms.longest else None

    # a switch ---------------------------------------------------------------------------------------------------------

    def _towards_switch(self, seen: Seen) -> Go | None:
        if seen.fresh:
            if seen.closed is not self._closed or not self._same:
                self._closed, self._same, self._edge, self._edge_counts = seen.closed, 0, seen.position, seen.counts
            self._same += 1
        if self._same < SURE:
            self._waited += seen.ended
            return self._fail(Why.NOT_FOUND) if self._waited > self.terms.patience else None
        if self.step is Step.SEARCH:
            return self._back_off() if self._closed else self._search(seen)
        if self.step is Step.BACK_OFF:
            return self._off_switch(seen)
        if self._closed:
            return self._found(self._edge_counts)
        return self._fail(Why.NOT_FOUND) if seen.ended else None

    def _search(self, seen: Seen) -> Go | None:
        if not self._leaves:
            self._leaves = True
            return Go(self._start + self.terms.direction * self.terms.way, self.terms.speed)
        return self._fail(Why.NOT_FOUND) if seen.ended else None

    def _back_off(self) -> Go:
        """As far as the way allows; once the switch is open, no further than CLEAR_S."""
        self.step, self._leaves = Step.BACK_OFF, True
        return Go(self._start - self.terms.direction * self.terms.way, self.terms.speed)

    def _off_switch(self, seen: Seen) -> Go | None:
        if self._closed:
            self._leaves = True
            return self._fail(Why.STAYS_CLOSED) if seen.ended else None
        if self._leaves:
            self._leaves = False
            return Go(self._edge - self.terms.direction * self._clear, self.terms.speed)
        return self._latch(self._edge) if seen.ended else None

    def _latch(self, edge: float) -> Go:
        self.step, self._leaves = Step.LATCH, True
        return Go(edge + self.terms.direction * self._clear, self.terms.latch_speed)

    # a stop -----------------------------------------------------------------------------------------------------------

    def _towards_stop(self, seen: Seen) -> Go | None:
        if self.step is Step.SEARCH:
            if not seen.blocked:
                return self._search(seen)
            self.step, self._first = Step.BACK_OFF, seen.position
            return Go(seen.position - self.terms.direction * self._clear, self.terms.speed)
        if self.step is Step.BACK_OFF:
            return self._latch(self._first) if seen.ended else None
        if not seen.blocked:
            return self._fail(Why.NOT_FOUND) if seen.ended else None
        if abs(seen.position - self._first) > 0.5 * self._clear:
            return self._fail(Why.TWO_PLACES)
        self._edge = seen.position
        return self._found(seen.counts)

    # found ------------------------------------------------------------------------------------------------------------

    def _found(self, counts: int) -> Go:
        """What is at `counts` is at `terms.at`: then to where the axis is wanted, or off the stop, or to rest."""
        terms = self.terms
        self.step, self.shift = Step.MOVE_TO, terms.at - counts
        if terms.move_to is not None:
            target = terms.move_to - self.shift * terms.resolution
            return self._fail(Why.BEYOND) if abs(target - self._start) > terms.way else Go(target, terms.speed)
        if terms.by == "stop":
            return Go(self._edge - terms.direction * self._clear, terms.speed)
        return Go(None, terms.speed)

    def _fail(self, why: Why) -> Go:
        self.why = why
        return Go(None, self.terms.speed)
