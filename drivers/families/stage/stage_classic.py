"""The fallback layout for buses without CAN FD: 8-byte frames, same safety. Contract: stage_classic.dbc.

Quantisation: force in steps of 1/2047 of the rated force (12 bits), sample time in 1 us, sequence modulo 32. No bit
is left to enable single axes; the torque value -2048, which no force maps to, says "disabled" instead.
"""

from collections.abc import Callable
from pathlib import Path
from typing import ClassVar, Final

from drivers.config import Wiring
from drivers.families.stage.common import StageLayout, cyclic_messages
from drivers.frame import FD, Frame
from drivers.protocols.base import OF_DRIVES, Command, LayoutError, Message, Reject, Sample
from drivers.protocols.checksum import IdentifiedCrc8
from drivers.protocols.common import MAX_AXES, check_force, reject_id
from drivers.protocols.dbc_codec import compile_codec, load_dbc

DBC = Path(__file__).with_name("stage_classic.dbc")
COMMAND_NAMES = ("torque_0", "torque_1", "torque_2", "torque_3", "sequence", "reset", "reserved", "checksum")
FEEDBACK_NAMES = ("position", "sample_time", "sequence", "status", "checksum")

SEQUENCE_MODULUS: Final = 32
LENGTH: Final = 8
FULL_SCALE: Final = 2047
DISABLED: Final = -2048

_WRAP_NS: Final = 4096 * 1000  # sample_time
_HALF_NS: Final = _WRAP_NS // 2
_WRAP: Final = 1 << 32  # position
_HALF: Final = 1 << 31
_BYTES = [bytes((value,)) for value in range(256)]


class _Layout(StageLayout):
    """What both ends share: codecs, scales."""

    name = "stage_classic"
    tells = OF_DRIVES  # seven bits, all taken
    fd = False
    sequence_modulus = SEQUENCE_MODULUS
    _wrap_ns = _WRAP_NS

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        database = load_dbc(DBC)
        self._command = compile_codec(database.get_message_by_name("Command"), COMMAND_NAMES)
        self._feedback = compile_codec(database.get_message_by_name("Feedback0"), FEEDBACK_NAMES)
        if (self._command.length, self._feedback.length) != (LENGTH, LENGTH):
            raise LayoutError(f"{DBC.name}: lengths {self._command.length} and {self._feedback.length}, not 8 and 8")
        self._rated = list(wiring.rated_force)
        self._absent = [DISABLED] * (MAX_AXES - wiring.n_axes)
        answers = range(self._feedback_id, self._feedback_id + wiring.n_axes)
        self._crc = IdentifiedCrc8([self._command_id, *answers])


class StageClassicHost(_Layout):
    """HostProtocol of stage_classic."""

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        self._axis = {self._feedback_id + axis: axis for axis in range(wiring.n_axes)}
        self._unpack_feedback: Callable[[bytes], tuple[int, int, int, int, int]] = self._feedback.unpack
        self._pack_command = self._command.pack

    def decode(self, frame: Frame) -> Sample | Reject:
        """Sample of a feedback frame; the stamp is the one nearest the frame's reception time, within 2.048 ms."""
        data, can_id, received = frame.data, frame.can_id, frame.timestamp_ns
        axis = self._axis.get(can_id)
        if axis is None:
            return reject_id(can_id, self._axis, self._command_id)
        if frame.flags & FD:
            return Reject.WRONG_FORMAT
        if len(data) != LENGTH:
            return Reject.WRONG_LENGTH
        if self._crc(can_id, data) != data[7]:
            return Reject.BAD_CHECKSUM
        position, stamp, sequence, status, _ = self._unpack_feedback(data)
        earliest = received - _HALF_NS
        stamp_ns = earliest + (stamp * 1000 - earliest) % _WRAP_NS
        return Sample(axis, position, status, sequence, stamp_ns)

    def encode(self, command: Command) -> list[Frame]:
        """The one command frame. Raises ValueError for a force that is not finite or beyond its rated force."""
        sequence, force, enable, reset = command
        check_force(force, self._rated)
        torque, can_id = [], self._command_id
        for axis, rated in enumerate(self._rated):
            torque.append(round(force[axis] * FULL_SCALE / rated) if enable >> axis & 1 else DISABLED)
        data = self._pack_command(*torque, *self._absent, sequence % SEQUENCE_MODULUS, reset, 0, 0)
        return [Frame(can_id, data[:7] + _BYTES[self._crc(can_id, data)])]

    def messages(self, period_ns: int) -> list[Message]:
        """One command, then one feedback per axis."""
        return cyclic_messages((self._command_id, LENGTH), (self._feedback_id, LENGTH), self.n_axes, False, period_ns)


class StageClassicDevice(_Layout):
    """DeviceProtocol of stage_classic. force_resolution: half a step as a fraction of the rated force."""

    force_resolution: ClassVar[float] = 0.5 / FULL_SCALE

    def decode_command(self, frame: Frame) -> Command | Reject:
        """The command for all axes; refused whole where any field is out of its range."""
        can_id, data, flags, _ = frame
        if can_id != self._command_id:
            return reject_id(can_id, (self._command_id,), -1)
        if flags & FD:
            return Reject.WRONG_FORMAT
        if len(data) != LENGTH:
            return Reject.WRONG_LENGTH
        *torque, sequence, reset, reserved, checksum = self._command.unpack(data)
        if self._crc(can_id, data) != checksum:
            return Reject.BAD_CHECKSUM
        if reserved or torque[self.n_axes :] != self._absent:
            return Reject.INVALID_VALUE
        del torque[self.n_axes :]
        enable = sum(1 << axis for axis, raw in enumerate(torque) if raw != DISABLED)
        force = [
            raw * rated / FULL_SCALE if raw != DISABLED else 0.0 for raw, rated in zip(torque, self._rated, strict=True)
        ]
        return Command(sequence, force, enable, bool(reset))

    def encode_feedback(self, sample: Sample) -> Frame:
        """The feedback frame of one axis; position wraps at 32 bits, the stamp is rounded to 1 us."""
        can_id = self._feedback_id + sample.axis
        position = (sample.position + _HALF) % _WRAP - _HALF
        stamp = (sample.stamp_ns + 500) // 1000 % 4096
        sequence = sample.sequence % SEQUENCE_MODULUS
        data = self._feedback.pack(position, stamp, sequence, sample.status & OF_DRIVES, 0)
        return Frame(can_id, data[:7] + _BYTES[self._crc(can_id, data)])
