"""The frame of `kind = "hil"`, sent in every tick behind the drives' command.

| bytes | content |
|---|---|
| 0 | bit i: output i is set |
| 1 | the same, inverted: what no node obeys where it does not fit |
| 2 | sequence, one more with every frame, modulo 256 |

A node sets all its outputs to 0 at its start and 10 ms after the last such frame.
"""

from collections.abc import Sequence
from typing import Final

from drivers.frame import Frame
from drivers.protocols.base import Reject

LENGTH: Final = 3
_NOTHING: Final[tuple[int, ...]] = ()


def output_frame(can_id: int, bits: int, sequence: int) -> Frame:
    """bits: 0 to 255. sequence: counted by the sender, modulo 256."""
    return Frame(can_id, bytes((bits & 0xFF, ~bits & 0xFF, sequence & 0xFF)))


class HilOutputFrame:
    """An OutputWriter. can_id: of the frame. bits: of the outputs that are in it."""

    def __init__(self, can_id: int, bits: int) -> None:
        self._can_id = can_id
        self.bits = bits
        self.ready = True
        self.can_ids: Sequence[int] = _NOTHING
        self.problem = ""

    def frame(self, bits: int, sequence: int) -> Frame:
        """See OutputWriter."""
        return output_frame(self._can_id, bits & self.bits, sequence)

    def hear(self, frame: Frame) -> Reject:
        """It answers with nothing."""
        return Reject.UNKNOWN_ID

    def service(self) -> Frame | None:
        """It needs nothing."""
        return None
