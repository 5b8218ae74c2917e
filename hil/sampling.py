"""From the inbox's samples to instants and positions that can be trusted, per axis.

The drives' stamps say when a sample was taken; their usual distance from the tick's start says when the next force will
act. A sample whose step is beyond belief is left out; where none came, the filter's prediction stands in and nothing is
learnt.
"""

from collections.abc import Sequence

from hil.faults import FaultMonitor
from hil.inbox import Inbox
from hil.laws.base import Array, LawInputs

LATENCY_SHIFT = 6  # the send-to-sample latency is averaged over 64 samples
LATENCY_STEP_NS = 1_000  # and followed in steps, so that a tick's end is the next one's start to the nanosecond
DELAY_SPREAD_NS = 100_000  # an estimated sampling delay this far above the usual is the answer's, not the sample's
DELAY_LEAK_NS = 200  # per tick, by which the usual delay may grow
LONGEST_PERIODS = 8  # a stamp that jumps is no reason to integrate for hours; the position is judged all the same


class Sampling:
    """Instants (integer ns on the samples' clock) and trusted positions of the newest samples.

    instants: of the filter's state. starts: expected start of the coming force's interval. latency: from the tick's
    start to the drives' sampling, averaged. tracked: there is a position to start from.
    """

    def __init__(
        self, inputs: LawInputs, inbox: Inbox, resolution: Sequence[float], period_ns: int, *, stamped: bool
    ) -> None:
        n = len(resolution)
        self._inputs = inputs
        self._inbox = inbox
        self._resolution = resolution
        self._period_ns = period_ns
        self._stamped = stamped
        self.instants = [0] * n
        self.starts = [0] * n
        self.latency = [0] * n
        self._average = [0] * n
        self._latency_known = [False] * n
        self._usual_delay = [0] * n  # lower envelope of estimated delays
        self._trusted = [0.0] * n  # last believed position, m, and its instant
        self._trusted_ns = [0] * n
        self.tracked = False
        self.stretched = False  # some interval is much longer than a period: slots were skipped

    def restart(self) -> None:
        """After a reset: what was learnt about the drives' clocks and positions counts no more."""
        self.tracked = False
        self._latency_known = [False] * len(self.latency)

    def take_instants(self, now_ns: int, sent_ns: int) -> list[float]:
        """Fill the inputs' intervals (s), for a tick that began at now_ns and a last command sent in the tick that
        began at sent_ns. Returns 1.0 per axis where a sample came, else 0.0.
        """
        period, intervals, ahead, fresh = self._period_ns, [], [], []
        arrived, instants = self._inbox.fresh, self.instants
        for axis, sample in enumerate(self._inbox.samples):
            previous = instants[axis]
            elapsed = period
            if arrived[axis] and sample is not None:
                instant = sent_ns + self._delay(axis, sample.stamp_ns - sent_ns)
                if self.tracked:
                    elapsed = min(max(instant - previous, 0), LONGEST_PERIODS * period)
                fresh.append(1.0)
            else:
                instant = previous + period
                fresh.append(0.0)
            instants[axis] = instant
            self.starts[axis] = start = now_ns + self.latency[axis]
            intervals.append(elapsed * 1e-9)
            ahead.append((start - instant) * 1e-9)
        self.stretched = max(intervals) > 1.5e-9 * period
        self._inputs.sample_interval[:] = intervals
        self._inputs.ahead[:] = ahead
        return fresh

    def _delay(self, axis: int, delay: int) -> int:
        """From the tick's start to the sampling, ns; keeps the average up to date."""
        if not self._stamped:
            delay = self._believable(axis, delay)
        if self._latency_known[axis]:
            self._average[axis] += (delay - self._average[axis]) >> LATENCY_SHIFT
            if abs(self._average[axis] - self.latency[axis]) > LATENCY_STEP_NS:
                self.latency[axis] = self._average[axis]
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

    def take_positions(self, fresh: list[float], predicted: Array, monitor: FaultMonitor) -> bool:
        """Fill the inputs' positions (m) from samples that can be true, else from `predicted`; clears `fresh` where a
        sample is not believed. True where every axis has a trusted sample.
        """
        position, complete = self._inputs.position, True
        for axis, sample in enumerate(self._inbox.samples):
            if fresh[axis] and sample is not None:
                measured = sample.position * self._resolution[axis]
                instant = self.instants[axis]
                periods = (instant - self._trusted_ns[axis]) / self._period_ns
                if not (self.tracked and monitor.implausible(axis, measured - self._trusted[axis], periods)):
                    position[axis] = self._trusted[axis] = measured
                    self._trusted_ns[axis] = instant
                    continue
                fresh[axis] = 0.0
            complete = False
            if self.tracked:
                position[axis] = predicted[axis]
        return complete
