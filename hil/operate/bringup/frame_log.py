"""Everything heard on a bus, by identifier, and held against what a frame layout expects there."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from drivers.families.cia402 import cia301
from drivers.families.cia402.cia301 import NmtState
from drivers.families.cia402.emergency import emergency_words
from drivers.frame import ECHO, ERROR, EXTENDED, FD, REMOTE, Frame
from drivers.protocols.base import Message, Reject

_PERIOD_RATIO = 1.5  # between a period seen and the one expected, either way
_MOST_EMERGENCIES = 64
Names = Callable[[int], int]
_BAD = (Reject.WRONG_LENGTH, Reject.WRONG_FORMAT, Reject.BAD_CHECKSUM, Reject.INVALID_VALUE)


@dataclass
class Heard:
    """The frames of one identifier. last: the newest."""

    last: Frame
    first_ns: int
    count: int = 0
    lengths: set[int] = field(default_factory=set)

    @property
    def period_s(self) -> float:
        """Mean, s; 0 before the second frame."""
        return (self.last.timestamp_ns - self.first_ns) * 1e-9 / (self.count - 1) if self.count > 1 else 0.0


class FrameLog:
    """heard: by identifier since `clear`. heartbeats: the last state of each CANopen node; boot_ups: messages of each;
    emergencies: in words, oldest first; all three since the start.
    """

    def __init__(
        self, emergency_ids: dict[int, int] | None = None, *, canopen: bool = False, whose: Names | None = None
    ) -> None:
        """emergency_ids: identifier -> node, beside those of the predefined connection set. canopen: its services are
        on this bus. whose: the identifier that a frame is counted under, its own where left out.
        """
        self.heard: dict[int, Heard] = {}
        self.error_frames = 0
        self.heartbeats: dict[int, int] = {}
        self.boot_ups: dict[int, int] = {}
        self.emergencies: list[str] = []
        self._canopen, self._whose = canopen, whose
        self._emergency_ids = emergency_ids or {}

    def clear(self) -> None:
        """Rates are counted from now on."""
        self.heard.clear()

    def add(self, frames: Sequence[Frame]) -> None:
        """Received frames; own echoes are passed over."""
        for frame in frames:
            if frame.flags & ECHO:
                continue
            if frame.can_id & ERROR:
                self.error_frames += 1
                continue
            can_id = self._whose(frame.can_id) if self._whose else frame.can_id
            heard = self.heard.setdefault(can_id, Heard(frame, frame.timestamp_ns))
            heard.count += 1
            heard.last = frame
            heard.lengths.add(len(frame.data))
            if self._canopen and not frame.flags & FD and not frame.can_id & (EXTENDED | REMOTE):
                self._note_service(frame)

    def _note_service(self, frame: Frame) -> None:
        node = frame.can_id & 0x7F
        if frame.can_id == cia301.HEARTBEAT_ID + node and node and len(frame.data) == 1:
            state = frame.data[0] & 0x7F
            self.heartbeats[node] = state
            if state == NmtState.BOOT_UP:
                self.boot_ups[node] = self.boot_ups.get(node, 0) + 1
        sender = self._emergency_ids.get(frame.can_id) or (node if frame.can_id == cia301.EMCY_ID + node else 0)
        if sender and len(frame.data) == 8 and len(self.emergencies) < _MOST_EMERGENCIES:
            self.emergencies.append(f"node {sender}: {emergency_words(frame.data)}")


class Comparison(NamedTuple):
    """One message that the layout expects, beside what was heard. frames: so many. period_s: 0 where fewer than two
    came. last: the newest. problem: what is not as expected, in words; empty where all is.
    """

    expected: Message
    frames: int
    period_s: float
    last: Frame | None
    problem: str


def compare(expected: Message, heard: Heard | None, rejects: Mapping[int, Reject], pace: float = 1.0) -> Comparison:
    """One expected message. rejects: why the newest frame of an identifier could not be read. pace: ticks took so many
    times their period, and with them all that answers the host.
    """
    if heard is None:
        return Comparison(expected, 0, 0.0, None, "never heard")
    reject = rejects.get(heard.last.can_id)
    period_s, due_s = heard.period_s, expected.period_ns * 1e-9 * (pace if expected.after else 1.0)
    problem = ""
    if not heard.lengths <= {expected.length, *expected.also}:
        lengths = ", ".join(str(length) for length in sorted(heard.lengths))
        problem = f"{lengths} bytes; expected {expected.length}"
    elif bool(heard.last.flags & FD) != expected.fd:
        problem = (
            f"{'CAN FD' if heard.last.flags & FD else 'classic'}; expected {'CAN FD' if expected.fd else 'classic'}"
        )
    elif reject in _BAD:
        problem = f"cannot be read: {reject.name.lower().replace('_', ' ')}"
    elif heard.count < 2 or not due_s / _PERIOD_RATIO <= period_s <= due_s * _PERIOD_RATIO:
        seen = f"every {period_s * 1e3:.3g} ms" if heard.count > 1 else "once"
        problem = f"{seen}; expected every {due_s * 1e3:.3g} ms"
    return Comparison(expected, heard.count, period_s, heard.last, problem)
