"""From the inbox's samples to instants and positions that can be trusted, per axis.

The drives' stamps say when a sample was taken; their usual distance from the tick's start says when the next force will
act. A sample whose step is implausible is left out; where none came, the filter's prediction stands in and nothing is
learnt.
"""

from collections.abc import Sequence
from typing import Final

from drivers.protocols.base import DriveStatus, Sample
from hil.control.error_map import ErrorMap
from hil.control.laws.base import LawInputs
from hil.cycle.drive_clock import DriveClock
from hil.cycle.fault_monitor import FaultMonitor
from hil.cycle.fault_table import Fault
from hil.cycle.inbox import Inbox

LATENCY_SHIFT: Final = 6  # the send-to-sample latency is averaged over 64 samples
LATENCY_STEP_NS: Final = 1_000  # and followed in steps, so that a tick's end is the next one's start to the nanosecond
_HOMED: Final = int(DriveStatus.HOMED)
LONGEST_PERIODS: Final = 8  # a stamp that jumps is no reason to integrate for hours; the position is checked anyway


class SampleClock:
    """One axis: when its samples were taken, when its next force will act, and which samples can be true.

    instant: of the filter's state, ns. latency: from the tick's start to the drive's sampling, averaged, ns. stretch:
    interval since the last sample in periods, where slots were skipped, else 1. trusted: last believed position, m.
    offset: counts added to the drive's. awaits_index: the drive is going to count from the encoder's index, and then
    says that it is homed. rebases: m a period: the drive, which homes by itself, counts anew where a step is longer; 0:
    it does not.
    """

    __slots__ = (
        "_average", "_drive", "_inputs", "_map", "_period_ns", "_resolution", "_trusted_ns",
        "awaits_index", "instant", "known", "latency", "offset", "rebases", "stretch", "trusted",
    )  # fmt: skip

    def __init__(
        self, inputs: LawInputs, resolution: float, period_ns: int, wrap_ns: int, error_map: ErrorMap | None
    ) -> None:
        """wrap_ns: after which the drive's stamps repeat; 0: they are of the host's clock."""
        self._inputs = inputs
        self._map = error_map
        self._drive = DriveClock(wrap_ns) if wrap_ns else None
        self._resolution = resolution
        self._period_ns = period_ns
        self.instant = self.latency = self._average = 0
        self.known = False  # the latency
        self.stretch = 1.0
        self.trusted, self._trusted_ns = 0.0, 0  # and its instant
        self.offset = 0
        self.awaits_index = False
        self.rebases = 0.0

    def take(
        self,
        axis: int,
        sample: Sample,
        sent_ns: int,
        received_ns: int,
        monitor: FaultMonitor,
        *,
        tracked: bool,
    ) -> bool:
        """An answer to the command of the tick that began at sent_ns; whether it is believed. Before the axes are
        `tracked` there is nothing to hold it against.
        """
        x, period = self._inputs, self._period_ns
        instant, drive = sample.stamp_ns, self._drive
        if drive is not None and received_ns > sent_ns:
            instant = drive.instant(instant, sent_ns, received_ns)
            if drive.outside_ns:
                wrong = Fault.STAMP if 2 * drive.outside_ns > drive.margin_ns else Fault.STAMP_GLITCH
                monitor.flag(wrong, drive.outside_ns * 1e-9, 0.0, axis)
                self.miss()
                return False
        self._learn(instant - sent_ns)
        if self.awaits_index and sample.status & _HOMED:
            self._pass_index(sample.position, (instant - self._trusted_ns) * 1e-9)
        if self.rebases:
            self._rebase(sample.position, instant)
        position = (sample.position + self.offset) * self._resolution
        if self._map is not None:
            position = self._map.corrected(position)
        if tracked:
            elapsed, longest = instant - self.instant, LONGEST_PERIODS * period
            elapsed = 0 if elapsed < 0 else elapsed if elapsed < longest else longest
            x.sample_interval = elapsed * 1e-9
            self.stretch = elapsed / period if 2 * elapsed > 3 * period else 1.0
        else:
            x.sample_interval, self.stretch = period * 1e-9, 1.0
        self.instant = instant
        if tracked and monitor.implausible(axis, position - self.trusted, (instant - self._trusted_ns) / period):
            x.fresh = 0.0
            return False
        x.position = self.trusted = position
        self._trusted_ns = instant
        x.fresh = 1.0
        return True

    def shift(self, counts: int) -> float:
        """The same place is `counts` further on from now on; by how much that is, m."""
        self.offset += counts
        by = counts * self._resolution
        self.trusted += by
        return by

    def _rebase(self, told: int, instant: int) -> None:
        """A step that no axis makes is a new zero; a second one is a fault."""
        step, elapsed_ns = (told + self.offset) * self._resolution - self.trusted, instant - self._trusted_ns
        if abs(step) > self.rebases * max(1.0, elapsed_ns / self._period_ns):
            self.rebases = 0.0
            self._pass_index(told, elapsed_ns * 1e-9)

    def _pass_index(self, told: int, seconds: float) -> None:
        """The drive's counts begin anew at the index; positions go on where the axis is."""
        self.awaits_index = False
        there = self.trusted + self._inputs.velocity_estimate * seconds
        self.offset = round(there / self._resolution) - told

    def restart(self) -> None:
        """What was learnt about the drive's clock counts no more."""
        self.known = False
        if self._drive is not None:
            self._drive.restart()

    def miss(self) -> None:
        """No answer came: the sample would have been taken a period after the last one."""
        self.instant += self._period_ns
        self.stretch = 1.0
        self._inputs.sample_interval = self._period_ns * 1e-9
        self._inputs.fresh = 0.0

    def _learn(self, delay: int) -> None:
        """Keep the averaged latency (ns) up to date."""
        if not self.known:
            self.latency = self._average = delay
            self.known = True
            return
        average = self._average
        self._average = average = average + ((delay - average) >> LATENCY_SHIFT)
        if not -LATENCY_STEP_NS <= average - self.latency <= LATENCY_STEP_NS:
            self.latency = average


class Sampling:
    """The sample clocks of all axes.

    instants: of the filters' state, integer ns on the samples' clock. starts: expected start of the coming force's
    interval. tracked: there is a position to start from. shares: part of the interval between two samples in which the
    force of the latest tick acted already, per axis: 0, except for drives that sample in their own time.

    wraps_ns: after which the stamps of drives with clocks of their own repeat, per axis. one_command:
    all drives sample at the same command. maps: corrections of the encoders' scales, by axis.

    acts_ns: of those drives, from the tick's start until the force acts, ns per axis; empty for all others, which
    sample when it does.
    """

    def __init__(
        self,
        inputs: Sequence[LawInputs],
        inbox: Inbox,
        resolution: Sequence[float],
        period_ns: int,
        acts_ns: Sequence[int] = (),
        wraps_ns: Sequence[int] = (),
        *,
        one_command: bool = False,
        maps: Sequence[ErrorMap | None] = (),
    ) -> None:
        self._inputs = list(inputs)
        self._inbox = inbox
        self.clocks = [
            SampleClock(x, r, period_ns, wraps_ns[axis] if wraps_ns else 0, maps[axis] if maps else None)
            for axis, (x, r) in enumerate(zip(self._inputs, resolution, strict=True))
        ]
        self._one_command = one_command and any(wraps_ns)
        self.instants = [0] * len(self.clocks)
        self.starts = [0] * len(self.clocks)
        self.shares = [0.0] * len(self.clocks)
        self._acts_ns = list(acts_ns)
        self._period_ns = period_ns
        self.tracked = False

    def restart(self) -> None:
        """After a reset: what was learnt about the drives' clocks and positions counts no more."""
        self.tracked = False
        for clock in self.clocks:
            clock.restart()

    def take(self, now_ns: int, sent_ns: int, monitor: FaultMonitor) -> None:
        """Fill the inputs' intervals (s) and `fresh`, and `position` (m) where a believable sample came; for a tick
        that began at now_ns and a last command sent in the tick that began at sent_ns.
        """
        inbox, inputs, instants, starts, tracked = self._inbox, self._inputs, self.instants, self.starts, self.tracked
        samples, arrived, answered = inbox.samples, inbox.fresh, 0.0
        received, together = inbox.received_ns, self._one_command
        first = _first_of(received, arrived) if together else 0  # all sample before the first of the answers comes
        for axis, clock in enumerate(self.clocks):
            sample = samples[axis]
            if arrived[axis] and sample is not None:
                came = first if together else received[axis]
                if clock.take(axis, sample, sent_ns, came, monitor, tracked=tracked):
                    answered = 1.0
            else:
                clock.miss()
            instants[axis] = instant = clock.instant
            starts[axis] = start = now_ns + clock.latency
            inputs[axis].ahead = (start - instant) * 1e-9
        if self._acts_ns:
            self._separate(now_ns)
        for x in inputs:
            x.answered = answered

    def _separate(self, now_ns: int) -> None:
        """Sampling and the force's beginning are two instants."""
        period = self._period_ns
        for axis, clock in enumerate(self.clocks):
            acts_ns = self._acts_ns[axis]
            self.starts[axis] = start = now_ns + acts_ns
            self._inputs[axis].ahead = max(0, start - self.instants[axis]) * 1e-9
            self.shares[axis] = min(max(clock.latency - acts_ns, 0), period) / period


def _first_of(received: list[int], arrived: list[bool]) -> int:
    """The earliest instant at which an answer came; 0 where none did."""
    first, found = 0, False
    for axis, fresh in enumerate(arrived):  # in compiled code a third of what min() of a list costs
        if fresh and (not found or received[axis] < first):
            first, found = received[axis], True
    return first
