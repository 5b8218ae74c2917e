"""What every kind of output node offers: bits to a frame, no I/O, no clock."""

from collections.abc import Sequence
from typing import Protocol

from drivers.frame import Frame
from drivers.protocols.base import Reject


class OutputWriter(Protocol):
    """The outputs of one node, as the host tells it.

    bits: of the rig's outputs, those that are its own. ready: it obeys; before that nothing is set. can_ids: what it
    answers with; none where it only listens. problem: why it is no good, for people; empty where all is well.
    """

    @property
    def bits(self) -> int:
        """See above."""

    @property
    def ready(self) -> bool:
        """See above."""

    @property
    def can_ids(self) -> Sequence[int]:
        """See above."""

    @property
    def problem(self) -> str:
        """See above."""

    def frame(self, bits: int, sequence: int) -> Frame:
        """The frame of one tick. bits: all that are set, others' among them. sequence: of the frames, modulo 256."""

    def hear(self, frame: Frame) -> Reject:
        """A frame of these identifiers came. Never raises, whatever the bytes."""

    def service(self) -> Frame | None:
        """Asked in ticks with room: a frame that configures or starts the node; None: nothing is due."""
