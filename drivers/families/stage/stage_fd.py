"""The default layout: CAN FD, one command frame for all axes, one feedback frame per axis.

Contract: stage_fd.dbc. Its two messages are of whole bytes, so that a struct says each; a test holds them equal to what
the DBC file says. So a control process on this layout needs no DBC parser.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from struct import Struct
from typing import Final
from zlib import crc32 as _crc32

from drivers.config import Wiring
from drivers.families.stage.common import StageLayout, cyclic_messages
from drivers.frame import BRS, FD, Frame
from drivers.native import path as native
from drivers.protocols.base import EVERY_STATUS, Command, Message, Reject, Sample
from drivers.protocols.common import MAX_AXES, check_force, reject_id

DBC = Path(__file__).with_name("stage_fd.dbc")
COMMAND: Final = Struct("<ffffHHI")  # force_0 to force_3, sequence, flags, checksum
FEEDBACK: Final = Struct("<iIHHI")  # position, sample_time, status, sequence, checksum

RESET: Final = 1 << MAX_AXES
SEQUENCE_MODULUS: Final = 1 << 16
COMMAND_LENGTH: Final = 24
FEEDBACK_LENGTH: Final = 16
COMMAND_CHECKED: Final = COMMAND_LENGTH - 4  # bytes the checksum covers
FEEDBACK_CHECKED: Final = FEEDBACK_LENGTH - 4
RESIDUE: Final = 0x2144DF1C  # CRC-32 of anything with its own CRC-32 behind it, least significant byte first

_WRAP: Final = 1 << 32  # sample_time, ns
_HALF: Final = 1 << 31
crc32: Final = _crc32
_SINGLE = Struct("<f")


def _plain_feedback(data: bytes, can_id: int, received_ns: int) -> tuple[int, int, int, int] | None:
    """Position, status, sequence and stamp in the bytes of a feedback frame; None: its checksum is wrong. The stamp is
    the one within 2^31 ns of received_ns.
    """
    if crc32(data, can_id) != RESIDUE:
        return None
    position, stamp, status, sequence, _ = FEEDBACK.unpack(data)
    earliest = received_ns - _HALF
    return position, status, sequence, earliest + (stamp - earliest) % _WRAP


def _plain_command(
    can_id: int, forces: Sequence[float], limits: tuple[float, ...], sequence: int, flags: int
) -> bytes | None:
    """The bytes of a command frame, of up to four forces in N or N m and a sequence number of 16 bits; None: a force is
    not finite or beyond its limit, of which there are four.
    """
    if len(forces) > MAX_AXES:
        return None
    a, b, c, d = (*forces, *(0.0,) * (MAX_AXES - len(forces)))
    la, lb, lc, ld = limits
    if not (-la <= a <= la and -lb <= b <= lb and -lc <= c <= lc and -ld <= d <= ld):
        return None
    data = COMMAND.pack(a, b, c, d, sequence, flags, 0)[:COMMAND_CHECKED]
    return data + crc32(data, can_id).to_bytes(4, "little")


_feedback: Final[Callable[[bytes, int, int], tuple[int, int, int, int] | None]] = (
    native.feedback if native else _plain_feedback
)
_command: Final[Callable[[int, Sequence[float], tuple[float, ...], int, int], bytes | None]] = (
    native.command if native else _plain_command
)
_answers: Final[Callable[[Sequence[Frame], int, int, int], bytes] | None] = native.answers if native else None


class _Layout(StageLayout):
    """What both ends share: identifiers and limits."""

    name = "stage_fd"
    tells = EVERY_STATUS
    fd = True
    sequence_modulus = SEQUENCE_MODULUS
    _wrap_ns = _WRAP

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        n_axes, rated_force = wiring.n_axes, wiring.rated_force
        # The largest force after rounding to single precision, so that a command of exactly the rated force passes.
        self._limits = [_SINGLE.unpack(_SINGLE.pack(force))[0] for force in rated_force]
        self._limits += [0.0] * (MAX_AXES - n_axes)
        self._enable_mask = (1 << n_axes) - 1


class StageFdHost(_Layout):
    """HostProtocol of stage_fd."""

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        n_axes, rated_force = wiring.n_axes, wiring.rated_force
        self._rated = (*rated_force, *[0.0] * (MAX_AXES - n_axes))

    def answers(self, frames: Sequence[Frame]) -> bytes:
        """Of each of the first frames that is a sound answer, six i64: the fields of the Sample that `decode` makes of
        it, in their order, and its time of reception. The frames behind those are `decode`'s.
        """
        return b"" if _answers is None else _answers(frames, self._feedback_id, self.n_axes, EVERY_STATUS)

    def decode(self, frame: Frame) -> Sample | Reject:
        """Sample of a feedback frame; the stamp is the one nearest the frame's reception time, within 2^31 ns."""
        data, can_id, received = frame.data, frame.can_id, frame.timestamp_ns
        axis = can_id - self._feedback_id
        if not 0 <= axis < self.n_axes:
            known = range(self._feedback_id, self._feedback_id + self.n_axes)
            return reject_id(can_id, known, self._command_id)
        if not frame.flags & FD:
            return Reject.WRONG_FORMAT
        if len(data) != FEEDBACK_LENGTH:
            return Reject.WRONG_LENGTH
        fields = _feedback(data, can_id, received)
        if fields is None:
            return Reject.BAD_CHECKSUM
        position, status, sequence, stamp_ns = fields
        if status > EVERY_STATUS:
            return Reject.INVALID_VALUE
        return Sample(axis, position, status, sequence, stamp_ns)

    def encode(self, command: Command) -> list[Frame]:
        """The one command frame. Raises ValueError for a force that is not finite or beyond its rated force."""
        sequence, force, enable, reset = command
        flags = enable & self._enable_mask | (RESET if reset else 0)
        data = _command(self._command_id, force, self._rated, sequence % SEQUENCE_MODULUS, flags)
        if data is None or len(force) != self.n_axes:
            if len(force) == self.n_axes:
                check_force(force, self._rated[: self.n_axes])  # says which
            raise ValueError(f"{len(force)} forces for {self.n_axes} axes")
        return [Frame(self._command_id, data, FD | BRS)]

    def messages(self, period_ns: int) -> list[Message]:
        """One command, then one feedback per axis."""
        command, feedback = (self._command_id, COMMAND_LENGTH), (self._feedback_id, FEEDBACK_LENGTH)
        return cyclic_messages(command, feedback, self.n_axes, True, period_ns)


class StageFdDevice(_Layout):
    """DeviceProtocol of stage_fd."""

    def decode_command(self, frame: Frame) -> Command | Reject:
        """The command for all axes; refused whole where any field is out of its range."""
        can_id, data, flags, _ = frame
        if can_id != self._command_id:
            return reject_id(can_id, (self._command_id,), -1)
        if not flags & FD:
            return Reject.WRONG_FORMAT
        if len(data) != COMMAND_LENGTH:
            return Reject.WRONG_LENGTH
        *force, sequence, bits, checksum = COMMAND.unpack(data)
        if crc32(data[:COMMAND_CHECKED], can_id) != checksum:
            return Reject.BAD_CHECKSUM
        if bits & ~(self._enable_mask | RESET):
            return Reject.INVALID_VALUE
        for value, limit in zip(force, self._limits, strict=True):
            if not -limit <= value <= limit:  # also where it is not a number
                return Reject.INVALID_VALUE
        return Command(sequence, force[: self.n_axes], bits & self._enable_mask, bool(bits & RESET))

    def encode_feedback(self, sample: Sample) -> Frame:
        """The feedback frame of one axis; position and stamp wrap at 32 bits."""
        can_id = self._feedback_id + sample.axis
        position, stamp = (sample.position + _HALF) % _WRAP - _HALF, sample.stamp_ns % _WRAP
        data = FEEDBACK.pack(position, stamp, sample.status & EVERY_STATUS, sample.sequence % SEQUENCE_MODULUS, 0)
        data = data[:FEEDBACK_CHECKED]
        return Frame(can_id, data + crc32(data, can_id).to_bytes(4, "little"), FD | BRS)
