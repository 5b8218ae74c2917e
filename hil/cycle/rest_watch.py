"""Does an axis that should rest move? From the positions of one axis in the states without torque.

Where an axis comes to rest, a window is laid around it. Two samples in a row outside are motion (one alone may be a
glitch); the window is laid again around the second, and the axis moves until SETTLED_S have passed without leaving it.
So a speed of a window in SETTLED_S counts as motion, and what is slower than a window in DRIFT_S (heat) never does.

Positions are the drives' own, whatever the filters make of them: of an axis that falls, no sample is plausible. A
step far beyond the speed limit (a leap) is the encoder's, as ENCODER_JUMP says, and so is noise of leaps to and fro: an
axis does not start or stop at once. Leaps that go on in one direction, or behind motion, are the axis. Nobody calls it
at rest meanwhile.

Behind a run an axis may still coast, or sag onto its brake. That is no fault for as long as friction may take to stop
it, if it does not get faster. One fast step is a step of the encoder; two in a row that way are the axis.
"""

from typing import Final

SETTLED_S: Final = 0.05
DRIFT_S: Final = 100.0
ENTRY_TICKS: Final = 5  # in which the last force still acts
OUTSIDE: Final = 2  # samples in a row
LEAPS: Final = 4  # in one direction, that are believed
FASTER_S: Final = 5e-3  # a window in this is how much faster a coasting axis may seem to get


class RestWatch:
    """window: m (rad). jump: most by which two samples of an axis that moves differ, m (rad) a tick. coasting_s:
    longest that friction takes to stop the axis. period_s: of the ticks.

    moving: the axis moves. restless: it does, or its encoder goes on leaping. allowed: it may, as it still coasts
    behind a run. distance: from where it rested, m (rad).
    """

    __slots__ = (
        "_ago",
        "_anchor",
        "_coasting",
        "_coasting_ticks",
        "_drift",
        "_fast",
        "_fastest",
        "_jump",
        "_known",
        "_last",
        "_leaps",
        "_outside",
        "_period_s",
        "_rested",
        "_settled",
        "_still",
        "allowed",
        "distance",
        "moving",
        "restless",
        "window",
    )  # fmt: skip

    def __init__(self, window: float, jump: float, coasting_s: float, period_s: float) -> None:
        self.window = window
        self._jump = max(jump, window)
        self._period_s = period_s
        self._drift = window * period_s / DRIFT_S
        self._settled = round(SETTLED_S / period_s)
        self._coasting_ticks = round(coasting_s / period_s)
        self.restart(coasting=False)

    def restart(self, *, coasting: bool) -> None:
        """The next position is where it rests. coasting: a run comes before it."""
        self.moving = self.restless = False
        self.allowed = coasting
        self._known = False
        self._anchor = self._rested = self._last = self.distance = 0.0
        self._outside = self._still = self._coasting = 0
        self._leaps = 0
        self._ago = 1  # ticks since the last sample
        self._fastest = 0.0
        self._fast = 0.0  # the last speed, where it was too fast, m/s

    def take(self, position: float) -> None:
        """A tick with a sample: its position, m (rad)."""
        if not self._known:
            self._known = True
            self._anchor = self._rested = self._last = position
        off, move = position - self._anchor, position - self._last
        leapt = self._leaps != 0
        self._leaps = self._count_leaps(move)
        believed = self._leaps == 0 or abs(self._leaps) >= LEAPS or self._outside > 0
        if -self.window <= off <= self.window:
            self._outside = 0
            self._anchor += min(max(off, -self._drift), self._drift)
        elif leapt and abs(move) <= self.window:
            self._anchor = self._rested = position
            self._outside = 0
        elif not believed:
            if leapt:
                self.restless = True
                self._still = 0
        else:
            self._outside += 1
            if self._outside >= OUTSIDE or self._leaps:
                self.moving = self.restless = True
                self._anchor = position
                self._still = self._outside = 0
        self.distance = abs(position - self._rested)
        if self.allowed:
            self._coast(move / (self._ago * self._period_s), believed)
        self._last = position
        self.pass_ticks(1)
        self._ago = 1

    def pass_ticks(self, ticks: int) -> None:
        """Time passes, with a sample or without: of a drive that fell silent nobody knows whether it moves."""
        self._still += ticks
        self._ago += ticks
        if self._still > self._settled:
            if self.moving:
                self._rested = self._anchor
            self.moving = self.restless = False

    def _count_leaps(self, move: float) -> int:
        """Leaps in a row with one of this size, m (rad); negative downwards."""
        jump = self._jump * self._ago
        if -jump <= move <= jump:
            return 0
        return max(self._leaps, 0) + 1 if move > 0.0 else min(self._leaps, 0) - 1

    def _coast(self, velocity: float, believed: bool) -> None:
        self._coasting += self._ago
        speed = abs(velocity)
        if self._coasting <= ENTRY_TICKS:
            if self._leaps not in (-1, 1):
                self._fastest = max(self._fastest, speed)
            return
        settled = not self.moving and self._still > self._settled
        fast = velocity if believed and speed > self._fastest + self.window / FASTER_S else 0.0
        faster = self.moving and fast * self._fast > 0.0
        self._fast = fast
        self.allowed = not (settled or faster or self._coasting > self._coasting_ticks)
