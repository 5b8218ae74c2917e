"""A drive's clock against the host's: which of its time stamps can be true, and when that was.

Rules:
- A sample is taken between the own command's sending and the answer's arrival, both known on the host's clock. So each
  answer bounds the offset between the clocks from both sides, and all answers together bound it closely.
- Sending and answering take time in every tick. Three quarters of the least seen are taken off the window at either
  end, never more than three quarters of the least round trip.
- The bounds widen with time by DRIFT, so that a clock that runs fast or slow is followed for ever.
- A stamp that no offset within the bounds explains is not believed, and never becomes an instant.
- A stamp wraps (Sample.stamp_ns is one of many equal ones): the one nearest the middle of its window counts.

The offset moves only as far as the bounds force it to. Where drive and host share a clock it stays 0, and instants are
the stamps themselves.
"""

from typing import Final

DRIFT: Final = 2_000  # a clock gains or loses less than a 2000th: 500 ppm
ROUNDING_NS: Final = 1_000  # of a stamp, at most
LEARNING: Final = 256  # answers before the least times are trusted
FORGET: Final = 2  # stamps in a row that cannot be true: the drive's clock was set anew, and is learnt anew


class DriveClock:
    """One axis' clock.

    wrap_ns: after which its stamps repeat, > 0. outside_ns: by how much the last stamp was beyond its bound; 0 for one
    that is believed. margin_ns: what was taken off the window.
    """

    __slots__ = (
        "_before_ns", "_high", "_known", "_late_ns", "_least_early_ns", "_least_late_ns", "_least_ns", "_low",
        "_offset", "_rejected", "_seen", "_wrap_ns", "margin_ns", "outside_ns",
    )  # fmt: skip

    def __init__(self, wrap_ns: int) -> None:
        self._wrap_ns = wrap_ns
        self._low = self._high = self._before_ns = 0
        self.restart()

    def restart(self) -> None:
        """What was learnt counts no more."""
        self._known = False
        self._offset = self._rejected = self.outside_ns = self._late_ns = self.margin_ns = self._seen = 0
        self._least_early_ns = self._least_late_ns = self._least_ns = 1 << 62

    def instant(self, stamp_ns: int, sent_ns: int, received_ns: int) -> int:
        """When the sample was taken, ns on the host's clock; where the stamp cannot be true, `outside_ns` is not 0.

        sent_ns, received_ns: between which it was taken.
        """
        if received_ns - sent_ns < self._least_ns:
            self._least_ns = received_ns - sent_ns
            if self._seen >= LEARNING:
                self._narrow()
        wrap, offset = self._wrap_ns, self._offset
        middle = (sent_ns + received_ns) // 2 + offset
        nearest = middle - stamp_ns + wrap // 2
        stamp_ns += nearest - nearest % wrap  # compiled, a product of such numbers takes 350 instructions
        low = stamp_ns - received_ns + self._late_ns - ROUNDING_NS
        high = stamp_ns - sent_ns - (self.margin_ns - self._late_ns) + ROUNDING_NS
        if self._known:
            drift = (sent_ns - self._before_ns) // DRIFT + 1
            least, most = self._low - drift, self._high + drift
            if low > most or high < least:
                self.outside_ns = max(low - most, least - high)
                self._rejected += 1
                if self._rejected < FORGET:
                    return stamp_ns - offset
            else:
                low, high = low if low > least else least, high if high < most else most
        self._known = True
        self.outside_ns = self._rejected = 0
        self._low, self._high, self._before_ns = low, high, sent_ns
        if not low <= offset <= high:
            self._offset = offset = low if offset < low else high
        instant_ns = stamp_ns - offset
        if self._seen < LEARNING:
            self._learn(instant_ns - sent_ns, received_ns - instant_ns)
        return instant_ns

    def _learn(self, early_ns: int, late_ns: int) -> None:
        self._least_early_ns = min(self._least_early_ns, max(early_ns, 0))
        self._least_late_ns = min(self._least_late_ns, max(late_ns, 0))
        self._seen += 1
        if self._seen == LEARNING:
            self._narrow()

    def _narrow(self) -> None:
        """The margins, from the least times; of a round trip that was shorter than both, in proportion."""
        parts = self._least_early_ns + self._least_late_ns
        whole = min(parts, self._least_ns) * 3 // 4
        self.margin_ns = whole
        self._late_ns = whole * self._least_late_ns // parts if parts else 0
