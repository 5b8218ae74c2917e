"""The sampling instant under layouts that carry no time stamp.

All drives sample when the frame that triggers them ends. Where the bus gives its sender that frame back, its stamp is
the instant. Where it does not: the drives' answers follow it back to back, so the instant is the reception of the first
answer less the time it took on the wire, which its bits tell exactly. Drives that sample in their own time each have
their own instant, which their steady period tells from the delays on the bus.
"""

from collections.abc import Sequence

from drivers.frame import Frame
from drivers.frame_length import INTERMISSION, frame_bits

DELAY_SPREAD_NS = 100_000  # an answer this much later than usual was held up on its way, and its sample was not
DELAY_LEAK_NS = 200  # per tick, by which what is usual may grow


class SamplingClock:
    """Estimates the sampling instant of each tick. Times in ns on the receiver's clock.

    What the estimate from an answer does not see is a drive's own delay between the trigger and its answer, and a
    frame that came in between.
    """

    def __init__(self, n_axes: int, bitrate: int, data_bitrate: int, period_ns: int) -> None:
        self._n_axes = n_axes
        self._nominal_ns = 1e9 / bitrate
        self._data_ns = 1e9 / data_bitrate
        self._period_ns = period_ns
        self._current_ns = -1  # of this tick
        self._last_ns = -1
        self._first_axis = 0
        self._begun_ns = [-1] * n_axes  # of drives that send in their own time
        self._usual_ns = -1  # lower envelope of the estimates, as the host triggers them once a period

    def trigger(self) -> None:
        """The frame that triggers sampling is about to be sent."""
        self._current_ns = -1

    def triggered(self, stamp_ns: int) -> None:
        """The frame that triggers sampling has been out at this time."""
        self._current_ns = self._last_ns = stamp_ns

    def instant(self, axis: int, frame: Frame) -> int:
        """When the sample in this answer was taken; -1 where the frame has no reception time."""
        if self._current_ns < 0 < frame.timestamp_ns:
            self._current_ns = self._estimate(axis, frame)
        return self._current_ns

    def begun(self, axis: int, frame: Frame, feedback_ns: int) -> int:
        """When a drive that samples and sends in its own time, every feedback_ns, has sampled; -1 where the frame has
        no reception time.

        The frame began on the wire no earlier, and later where others went first. Of these delays the least that the
        steady period allows is believed, so that a busy bus does not look like a drive that samples unevenly.
        """
        if frame.timestamp_ns <= 0:
            return -1
        nominal, data = frame_bits(frame)
        begun = frame.timestamp_ns - round(nominal * self._nominal_ns + data * self._data_ns)
        usual = self._begun_ns[axis]
        if usual >= 0:
            usual += (begun - usual + feedback_ns // 2) // feedback_ns * feedback_ns + DELAY_LEAK_NS
        if usual < 0 or begun < usual or begun - usual > feedback_ns // 2 - DELAY_LEAK_NS:
            usual = begun
        self._begun_ns[axis] = usual
        return usual

    def _estimate(self, axis: int, frame: Frame) -> int:
        """From the first answer. Where another axis than before is first, the usual one may be lost: then as many
        answers are taken to have gone before as explain best that one period has passed."""
        nominal, data = frame_bits(frame)
        duration = (nominal + INTERMISSION) * self._nominal_ns + data * self._data_ns
        instant = frame.timestamp_ns - round(duration)
        if axis != self._first_axis and self._last_ns >= 0:
            expected = self._last_ns + self._period_ns
            earlier = [instant - round(lost * duration) for lost in range(self._n_axes)]
            instant = min(earlier, key=lambda candidate: abs(candidate - expected))
        self._first_axis, self._last_ns = axis, instant
        return self._believable(instant)

    def _believable(self, instant: int) -> int:
        """An estimated instant, unless the answer it comes from was merely held up: then the usual one."""
        usual = self._usual_ns
        if usual >= 0:
            usual += (instant - usual + self._period_ns // 2) // self._period_ns * self._period_ns
        if usual < 0 or instant < usual:
            usual = instant
        self._usual_ns = usual + DELAY_LEAK_NS
        return usual if instant > usual + DELAY_SPREAD_NS else instant


def leads_ns(frames: Sequence[Frame], bitrate: int, data_bitrate: int) -> list[int]:
    """By how much each of these frames, sent back to back, is out before the last one is, ns."""
    leads = [0] * len(frames)
    behind_ns = 0.0
    for index in range(len(frames) - 1, -1, -1):
        leads[index] = round(behind_ns)
        nominal, coded = frame_bits(frames[index])
        behind_ns += (nominal + INTERMISSION) * 1e9 / bitrate + coded * 1e9 / data_bitrate
    return leads
