"""Does a loop swing to and fro by itself? From the turning points of one axis' following error.

A loop that has lost its margin, or rings on a mode nobody modelled, circles inside the following-error limit for ever.
Its error then turns again and again, as far each time as the time before. So: three swings in a row (one and a half
periods) that do not fade, each over within LONGEST_SWING_S, the last of them of the limit's amplitude, are an
oscillation. What a disturbance leaves behind fades (at a phase margin of 15 degrees to two thirds a swing), and a task
that repeats turns more slowly.

Theory of operation: the extreme since the last turning point is kept. The error has turned once it is HYSTERESIS
amplitudes away from it, so that neither noise nor a ripple on a slow error counts. A growing oscillation is seen at the
turning point at which it reaches the amplitude, one that begins at once after three swings.
"""

from typing import Final

LONGEST_SWING_S: Final = 0.1  # half a period of 5 Hz
SWINGS: Final = 3
LASTING: Final = 0.8  # of the swing before: less is fading
HYSTERESIS: Final = 0.25  # of the amplitude
SMALL: Final = 0.5  # of the amplitude: smaller swings do not count


class OscillationDetector:
    """amplitude: m (rad), at which a swing to and fro counts as an oscillation; period_s: of the ticks."""

    __slots__ = (
        "_age",
        "_amplitude",
        "_count",
        "_extreme",
        "_hysteresis",
        "_least",
        "_longest",
        "_rising",
        "_swing",
        "_turned_at",
        "swing",
    )

    def __init__(self, amplitude: float, period_s: float) -> None:
        self._amplitude = amplitude
        self._hysteresis = HYSTERESIS * amplitude
        self._least = 2.0 * SMALL * amplitude
        self._longest = int(LONGEST_SWING_S / period_s)
        self.restart(0.0)

    def restart(self, error: float) -> None:
        """Begin anew at this following error (m)."""
        self._extreme = self._turned_at = error
        self._age = 0  # ticks since the extreme
        self._count = 0  # swings that last
        self._swing = 0.0  # the latest, between two turning points
        self._rising = True
        self.swing = 0.0  # half the latest that counted, m: the amplitude

    def seen(self, error: float) -> bool:
        """Whether this tick's following error (m) completes an oscillation. To be called in every tick."""
        back = self._extreme - error if self._rising else error - self._extreme
        if back <= 0.0:
            self._extreme = error
            self._age += 1
            return False
        if back < self._hysteresis:
            self._age += 1
            return False
        return self._turn(error)

    def _turn(self, error: float) -> bool:
        """The extreme was a turning point: judge the swing that ended there."""
        before, swing = self._swing, abs(self._extreme - self._turned_at)
        lasting = self._least <= swing and self._age <= self._longest
        self._count = (self._count + 1 if swing >= LASTING * before else 1) if lasting else 0
        self._swing, self._turned_at = swing, self._extreme
        self._extreme, self._rising, self._age = error, not self._rising, 0
        self.swing = 0.5 * swing
        return self._count >= SWINGS and self.swing >= self._amplitude
