"""An emulated output node: switches what the host's output frame says, and nothing once the host is silent.

The frame: classic CAN, 3 bytes. Byte 0: the outputs, a bit each. Byte 1: the same, every bit inverted. Byte 2: a number
that is another one in each frame.
"""

from drivers.frame import FD, Frame

SILENCE_NS = 10_000_000  # without a valid frame, until everything is off
NEVER_NS = 2**62
_LENGTH = 3


class OutputNode:
    """One node. output_id: identifier of the host's frame.

    bits: what is on now; nothing at the start. deadline_ns: when it goes off by itself; NEVER_NS: nothing is on.
    taken, ignored: frames that were valid, and that were not. can_ids: what it answers with.
    """

    can_ids: tuple[int, ...] = ()

    def __init__(self, output_id: int) -> None:
        self.output_id = output_id
        self.bits = 0
        self.deadline_ns = NEVER_NS
        self.taken = self.ignored = 0
        self._sequence = -1

    def hear(self, frame: Frame, now_ns: int) -> None:
        """A frame with its identifier came."""
        data = frame.data
        if len(data) != _LENGTH or frame.flags & FD or data[0] ^ data[1] != 0xFF or data[2] == self._sequence:
            self.ignored += 1
            return
        self._sequence = data[2]
        self._take(data[0], now_ns)

    def _take(self, bits: int, now_ns: int) -> None:
        self.taken += 1
        self.bits = bits
        self.deadline_ns = now_ns + SILENCE_NS if bits else NEVER_NS

    def heed(self, frame: Frame, now_ns: int) -> list[Frame]:
        """Another frame came; what a node with `can_ids` answers."""
        return []

    def expire(self, now_ns: int) -> None:
        """Time has come to now_ns."""
        if self.deadline_ns <= now_ns:
            self.bits, self.deadline_ns = 0, NEVER_NS
