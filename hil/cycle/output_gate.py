"""The gate of the outputs: the only code that sets one.

Rules:
- An output is set only where the state permits it, in no tick with a fault, and never longer than its configuration
  says; then it stays 0 until it has not been asked for.
- As often as the drives are told anything the node is told as well; where nothing is sent, it falls to 0 by itself.
"""

from collections.abc import Sequence

from drivers.frame import Frame
from drivers.outputs.config import OutputConfig
from drivers.outputs.hil_frame import output_frame


class OutputGate:
    """set: the bits that are 1 in the latest frame."""

    def __init__(self, outputs: Sequence[OutputConfig], period_ns: int) -> None:
        self._can_id = outputs[0].can_id
        self._most = {output.bit: int(output.longest_s * 1e9) // period_ns for output in outputs}
        self._ticks = dict.fromkeys(self._most, 0)
        self._sequence = 0
        self.set = 0

    def release(self, asked: int, *, permitted: bool) -> Frame:
        """The frame of one tick. asked: bit i for output i; bits that no output has are 0 whatever is asked."""
        bits = 0
        for bit, most in self._most.items():
            if not asked >> bit & 1:
                self._ticks[bit] = 0
            elif permitted and self._ticks[bit] < most:
                self._ticks[bit] += 1
                bits |= 1 << bit
            else:
                self._ticks[bit] = most  # not again before it was not asked for
        self.set = bits
        self._sequence = (self._sequence + 1) % 256
        return output_frame(self._can_id, bits, self._sequence)

    def cut(self) -> None:
        """Nothing is sent in this tick."""
        self.set = 0
