"""A stream of knots from elsewhere: what the way there adds at random is taken out again.

Each knot says when it was sent and how long after that it is due, on its sender's clock. Clocks are not compared: the
quickest knot of the last KEPT has come without delay, by definition. All are due `delay_ns` later than they ask for,
INTERVALS intervals of the stream, and so have that long to arrive.
"""

from collections import deque
from statistics import median_low
from typing import Final

INTERVALS: Final = 2
FIRST_NS: Final = 20_000_000  # the interval of a stream that has one knot
LEAST_NS: Final = 1_000_000
MOST_NS: Final = 100_000_000
NEW_NS: Final = 1_000_000_000  # after such a silence it is another stream
KEPT: Final = 64


class JitterBuffer:
    """late: knots that came after their time, so far. disordered: those not due after the newest. delay_ns: of now."""

    def __init__(self) -> None:
        self.late = self.disordered = 0
        self.delay_ns = 0
        self._ways: deque[int] = deque(maxlen=KEPT)  # arrival less sending, on two clocks
        self._intervals: deque[int] = deque(maxlen=9)
        self._sent_ns = self._due_ns = 0  # of the newest, on the sender's clock

    def forget(self) -> None:
        """Who sends has changed."""
        self._ways.clear()
        self._intervals.clear()
        self.delay_ns = 0

    def due(self, sent_ns: int, due_ns: int, arrived_ns: int) -> int | None:
        """In how long a knot is due that has just arrived, ns; None: it is dropped, and counted."""
        if self._ways and abs(sent_ns - self._sent_ns) > NEW_NS:
            self.forget()
        wanted_ns = sent_ns + due_ns
        if self._ways:
            if wanted_ns <= self._due_ns:
                self.disordered += 1
                return None
            self._intervals.append(min(max(wanted_ns - self._due_ns, LEAST_NS), MOST_NS))
        self._ways.append(arrived_ns - sent_ns)
        self._sent_ns, self._due_ns = sent_ns, wanted_ns
        self.delay_ns = INTERVALS * (median_low(self._intervals) if self._intervals else FIRST_NS)
        left_ns = wanted_ns + min(self._ways) + self.delay_ns - arrived_ns
        if left_ns <= 0:
            self.late += 1
            return None
        return left_ns
