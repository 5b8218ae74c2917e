"""From the inbox's samples to instants and positions that can be trusted, per axis.

The drives' stamps say when a sample was taken; their usual distance from the tick's start says when the next force will
act. A sample whose step is beyond belief is left out; where none came, the filter's prediction stands in and nothing is
learnt.
"""

from collections.abc import Sequence

from hil.faults import FaultMonitor
from hil.inbox import Inbox
from hil.laws.base import LawInputs

LATENCY_SHIFT = 6  # the send-to-sample latency is averaged over 64 samples
LATENCY_STEP_NS = 1_000  # and followed in steps, so that a tick's end is the next one's start to the nanosecond
DELAY_SPREAD_NS = 100_000  # an estimated sampling delay this far above the usual is the answer's, not the sample's
DELAY_LEAK_NS = 200  # per tick, by which the usual delay may grow
LONGEST_PERIODS = 8  # a stamp that jumps is no reason to integrate for hours; the position is judged all the same


class Sampling:
    """Instants (integer ns on the samples' clock) and trusted positions of the newest samples.

    instants: of the filter's state. starts: expected start of the coming force's interval. latency: from the tick's
    start to the drives' sampling, averaged. stretch: interval since the last sample in periods, where slots were
    skipped, else 1. tracked: there is a position to start from.
    """

    def __init__(
        self, inputs: Sequence[LawInputs], inbox: Inbox, resolution: Sequence[float], period_ns: int, *, stamped: bool
    ) -> None:
        n = len(resolution)
        self._inputs = list(inputs)
        self._inbox = inbox
        self._resolution = resolution
        self._period_ns = period_ns
        self._stamped = stamped
        self.instants = [0] * n
        self.starts = [0] * n
        self.latency = [0] * n
        self.stretch = [1.0] * n
        self._average = [0] * n
        self._latency_known = [False] * n
        self._usual_delay = [0] * n  # lower envelope of estimated delays
        self._trusted = [0.0] * n  # last believed position, m, and its instant
        self._trusted_ns = [0] * n
        self.tracked = False

    def restart(self) -> None:
        """After a reset: what was learnt about the drives' clocks and positions counts no more."""
        self.tracked = False
        self._latency_known = [False] * len(self.latency)

    def take(self, now_ns: int, sent_ns: int, monitor: FaultMonitor) -> None:
        """Fill the inputs' intervals (s) and `fresh`, and `position` (m) where a believable sample came; for a tick
        that began at now_ns and a last command sent in the tick that began at sent_ns.
        """
        inbox, instants, period, tracked, answered = self._inbox, self.instants, self._period_ns, self.tracked, 0.0
        arrivals = zip(self._inputs, inbox.samples, inbox.fresh, strict=True)
        for axis, (x, sample, arrived) in enumerate(arrivals):
            previous, elapsed = instants[axis], period
            x.fresh = 0.0
            if arrived and sample is not None:
                instant = sent_ns + self._delay(axis, sample.stamp_ns - sent_ns)
                if tracked:
                    elapsed = min(max(instant - previous, 0), LONGEST_PERIODS * period)
                position = sample.position * self._resolution[axis]
                if self._believed(axis, position, instant, monitor):
                    x.position, x.fresh = position, 1.0
                    answered = 1.0
            else:
                instant = previous + period
            instants[axis] = instant
            self.starts[axis] = start = now_ns + self.latency[axis]
            x.sample_interval = elapsed * 1e-9
            x.ahead = (start - instant) * 1e-9
            self.stretch[axis] = elapsed / period if 2 * elapsed > 3 * period else 1.0
        for x in self._inputs:
            x.answered = answered

    def _believed(self, axis: int, position: float, instant: int, monitor: FaultMonitor) -> bool:
        """Whether a sample can be true; the first ones must be."""
        periods = (instant - self._trusted_ns[axis]) / self._period_ns
        if self.tracked and monitor.implausible(axis, position - self._trusted[axis], periods):
            return False
        self._trusted[axis], self._trusted_ns[axis] = position, instant
        return True

    def _delay(self, axis: int, delay: int) -> int:
        """From the tick's start to the sampling, ns; keeps the average up to date."""
        if not self._stamped:
            delay = self._believable(axis, delay)
        if self._latency_known[axis]:
            average = self._average[axis]
            self._average[axis] = average = average + ((delay - average) >> LATENCY_SHIFT)
            if not -LATENCY_STEP_NS <= average - self.latency[axis] <= LATENCY_STEP_NS:
                self.latency[axis] = average
        else:
            self.latency[axis] = self._average[axis] = delay
            self._latency_known[axis] = True
        return delay

    def _believable(self, axis: int, delay: int) -> int:
        """An estimated sampling delay (ns), unless the answer was merely held up on its way: then the usual one."""
        usual = self._usual_delay[axis]
        if not self._latency_known[axis] or delay < usual:
            usual = delay
        self._usual_delay[axis] = usual + DELAY_LEAK_NS
        return usual if delay > usual + DELAY_SPREAD_NS else delay
