"""The sampling instant under layouts that carry no time stamp.

All drives sample when the frame that triggers them ends; their answers follow it back to back. So the instant is the
reception of the first answer less the time it took on the wire, which its bits tell exactly.
"""

from drivers.frame import Frame
from drivers.frame_length import INTERMISSION, frame_bits


class SamplingClock:
    """Estimates the sampling instant of each tick. Times in ns on the receiver's clock.

    What is not seen is a drive's own delay between the trigger and its answer, and a frame that came in between.
    """

    def __init__(self, n_axes: int, bitrate: int, data_bitrate: int, period_ns: int) -> None:
        self._n_axes = n_axes
        self._nominal_ns = 1e9 / bitrate
        self._data_ns = 1e9 / data_bitrate
        self._period_ns = period_ns
        self._current_ns = -1  # of this tick
        self._last_ns = -1
        self._first_axis = 0

    def trigger(self) -> None:
        """The frame that triggers sampling is about to be sent."""
        self._current_ns = -1

    def instant(self, axis: int, frame: Frame) -> int:
        """When the sample in this answer was taken; -1 where the frame has no reception time."""
        if self._current_ns < 0 < frame.timestamp_ns:
            self._current_ns = self._estimate(axis, frame)
        return self._current_ns

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
        return instant
