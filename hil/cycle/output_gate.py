"""The gate of the outputs: the only code that sets one.

Rules:
- An output is set only where the state permits it, in no tick with a fault, and never longer than its configuration
  says; then it stays 0 until it has not been asked for. The same holds while its node is not ready.
- As often as the drives are told anything the nodes are told as well; where nothing is sent, they fall to 0 by
  themselves.
"""

from collections.abc import Sequence

from drivers.frame import Frame, segment_of
from drivers.outputs.base import OutputWriter
from drivers.outputs.config import OutputConfig
from drivers.protocols.base import Reject


class OutputGate:
    """writers: who tells the nodes, one for each frame. set: the bits that are 1 in the latest frames."""

    def __init__(self, outputs: Sequence[OutputConfig], writers: Sequence[OutputWriter], period_ns: int) -> None:
        self._writers = list(writers)
        self._heard = {can_id: writer for writer in writers for can_id in writer.can_ids}
        self._served = [writer for writer in writers if writer.can_ids]
        self._turn = 0
        self._most = {output.bit: int(output.longest_s * 1e9) // period_ns for output in outputs}
        self._ticks = dict.fromkeys(self._most, 0)
        self._sequence = 0
        self.set = 0

    def knows(self, frame: Frame) -> bool:
        """Whether it is a frame of one of the nodes; these are on the first segment."""
        return frame.can_id in self._heard and not segment_of(frame)

    def take(self, frame: Frame) -> Reject:
        """A frame that it `knows`; what it is."""
        return self._heard[frame.can_id].hear(frame)

    @property
    def problems(self) -> list[str]:
        """Why nodes are no good, for people."""
        return [writer.problem for writer in self._writers if writer.problem]

    def release(self, asked: int, *, permitted: bool) -> list[Frame]:
        """The frames of one tick. asked: bit i for output i; bits that no output has are 0 whatever is asked."""
        ready = bits = 0
        for writer in self._writers:
            if writer.ready:
                ready |= writer.bits
        for bit, most in self._most.items():
            if not asked >> bit & 1:
                self._ticks[bit] = 0
            elif permitted and ready >> bit & 1 and self._ticks[bit] < most:
                self._ticks[bit] += 1
                bits |= 1 << bit
            else:
                self._ticks[bit] = most  # not again before it was not asked for
        self.set = bits
        self._sequence = (self._sequence + 1) % 256
        return [writer.frame(bits, self._sequence) for writer in self._writers]

    def service(self) -> list[Frame]:
        """The frame that one of the nodes is due, if any: at most one a tick, in turn."""
        for _ in self._served:
            self._turn = (self._turn + 1) % len(self._served)
            frame = self._served[self._turn].service()
            if frame is not None:
                return [frame]
        return []

    def cut(self) -> None:
        """Nothing is sent in this tick."""
        self.set = 0
