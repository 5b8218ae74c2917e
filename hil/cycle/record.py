"""The fixed-size record of one tick: what the control process leaves in the ring, and all that replay needs.

Little-endian, SI units, 4096 bytes. Per-axis arrays have MAX_AXES places; those beyond the rig's axes are zero.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from librt.strings import read_i64_le
from librt.vecs import vec
from mypy_extensions import i64

from drivers.frame import Frame
from hil.cycle.tick import OperatorCommand
from hil.rig.schema import MAX_AXES

MAX_RECEIVED: Final = 32
MAX_SENT: Final = 6
MAX_COMMANDS: Final = 4
REJECT_REASONS = 10  # drivers.protocols.base.Reject

_AXES = (MAX_AXES,)

FRAME = np.dtype(
    [
        ("timestamp_ns", "<i8"),
        ("can_id", "<u4"),
        ("length", "u1"),
        ("flags", "u1"),
        ("reserved", "<u2"),
        ("data", "u1", 64),
    ]
)  # 80 bytes
COMMAND = np.dtype([("kind", "<u4"), ("accepted", "<u4"), ("sequence", "<u8"), ("expires_ns", "<i8")])

_FIELDS = [
    # the tick
    ("index", "<i8"),
    ("scheduled_ns", "<i8"),
    ("now_ns", "<i8"),
    ("state", "<u4"),  # hil.cycle.state_machine.State
    ("fault", "<u4"),  # hil.cycle.fault_monitor.Fault that latched, 0: none
    ("faults_active", "<u8"),  # bit f set: detector f fires in this tick
    ("flags", "<u4"),  # bit 0 stop, 1 recorder_ok, 2 realtime_ok, 3 rig_ok, 4 sending, 5 estop
    ("sequence", "<u4"),
    ("task_ns", "<i8"),  # time on the task's clock; -1: no task runs
    # per axis
    ("position", "<f8", _AXES),  # measured, m
    ("position_estimate", "<f8", _AXES),
    ("velocity_estimate", "<f8", _AXES),
    ("disturbance_estimate", "<f8", _AXES),
    ("innovation", "<f8", _AXES),
    ("setpoint_position", "<f8", _AXES),  # at the sample's time stamp
    ("setpoint_velocity", "<f8", _AXES),
    ("following_error", "<f8", _AXES),  # position - setpoint_position, both at the sample's time stamp
    ("force_requested", "<f8", _AXES),  # by the law
    ("force", "<f8", _AXES),  # let out by the gate
    ("stamp_ns", "<i8", _AXES),
    ("age_ticks", "<u4", _AXES),  # since the last accepted sample
    ("drive_status", "<u4", _AXES),
    # counters, cumulative
    ("port", "<u8", (12,)),  # hil.cycle.tick.PortCounters, state last
    ("rejects", "<u8", (REJECT_REASONS,)),
    ("samples_lost", "<u8"),
    ("missed_own", "<u8"),
    ("missed_host", "<u8"),
    ("longest_streak", "<u8"),
    ("illegal_events", "<u8"),
    ("commands_refused", "<u8"),
    ("law_floors", "<u8"),  # denominators floored by the law
    ("saturations", "<u8", _AXES),  # ticks in which the gate clamped or rate-limited
    # of the previous tick, written by the shell: ns of CPU per stage, and of run delay
    ("cpu_ns", "<u4", (5,)),  # read, estimate, control, gate, send
    ("run_delay_ns", "<u4"),
    # everything replay needs
    ("n_commands", "<u2"),
    ("n_received", "<u2"),
    ("n_sent", "<u2"),
    ("reserved", "<u2"),
    ("commands", COMMAND, (MAX_COMMANDS,)),
    ("sent", FRAME, (MAX_SENT,)),
    ("received", FRAME, (MAX_RECEIVED,)),
]

_USED = np.dtype(_FIELDS).itemsize
RECORD_SIZE: Final = 4096
RECORD = np.dtype([*_FIELDS, ("padding", "u1", RECORD_SIZE - _USED)])

MOTION_FIELDS = (
    "position",
    "position_estimate",
    "velocity_estimate",
    "disturbance_estimate",
    "innovation",
    "setpoint_position",
    "setpoint_velocity",
    "following_error",
    "force_requested",
    "force",
)

_LAYOUT: dict[str, Any] = dict(RECORD.fields or {})


def _word(field: str) -> int:
    """Which of the record's 8-byte words a field begins in."""
    return int(_LAYOUT[field][1]) // 8


_MOTION: Final = _word(MOTION_FIELDS[0])
_STAMP: Final = _word("stamp_ns")  # where the motion fields end
_AGE: Final = _word("age_ticks")
_STATUS: Final = _word("drive_status")
_PORT: Final = _word("port")
_REJECTS: Final = _word("rejects")
_LOST: Final = _word("samples_lost")
_MISSED: Final = _word("missed_own")
_ILLEGAL: Final = _word("illegal_events")
_SATURATIONS: Final = _word("saturations")
_SPENT: Final = _word("cpu_ns")
_COUNTS: Final = _word("n_commands")
_COMMANDS: Final = _word("commands")
_SENT: Final = _word("sent")
_RECEIVED: Final = _word("received")
_COMMAND_WORDS: Final = COMMAND.itemsize // 8
_FRAME_WORDS: Final = FRAME.itemsize // 8
_PADDING: Final = bytes(7)

_MAX_U32: Final = 0xFFFFFFFF
_HALF_U32: Final = 0x80000000
_MAX_U64: Final = 2**64 - 1
_HALF_U64: Final = 2**63


def _pair(low: int, high: int) -> int:
    """The i64 that holds two u32, `low` in its lower half; of a larger number its lower 32 bits."""
    return (((high + _HALF_U32) & _MAX_U32) - _HALF_U32) << 32 | low & _MAX_U32


def _bits(value: int) -> int:
    """The i64 with the bits of a u64; of a larger number its lower 64 bits."""
    return ((value + _HALF_U64) & _MAX_U64) - _HALF_U64


def _at_most_u32(value: int) -> int:
    return value if value < _MAX_U32 else _MAX_U32


class RecordBuilder:
    """One record, written over and over: its parts in any order, and `traffic` last, which puts it together.

    The parts are kept in arrays of machine words and of doubles. Compiled, a number written there takes a few
    instructions, where struct takes a hundred and more; interpreted, both cost about the same. What is too large for
    its field is cut: no number, however absurd, may raise in the control process.
    """

    def __init__(self, n_axes: int) -> None:
        self._words: vec[i64] = vec[i64]([0] * (RECORD_SIZE // 8))  # all but the motion fields
        self._motion: vec[float] = vec[float]([0.0] * (_STAMP - _MOTION))
        # What the words hold already: it seldom changes.
        self._age_ticks = self._status = [0] * n_axes
        self._rejects = [0] * REJECT_REASONS
        self._lengths = [0] * (MAX_SENT + MAX_RECEIVED)  # of the data in each frame's place
        buffer = bytearray(RECORD_SIZE)
        self.record: np.void = np.frombuffer(buffer, dtype=RECORD)[0]
        record, words = memoryview(buffer), memoryview(self._words).cast("B")
        begin, end = 8 * _MOTION, 8 * _STAMP
        # The record's parts, each with what it is a copy of; the last one by the number of frames received.
        self._to_head, self._head = record[:begin], words[:begin]
        self._to_motion, self._from_motion = record[begin:end], memoryview(self._motion).cast("B")
        used = [8 * (_RECEIVED + _FRAME_WORDS * received) for received in range(MAX_RECEIVED + 1)]
        self._to_rest, self._rest = [record[end:last] for last in used], [words[end:last] for last in used]

    def tick(
        self, index: int, scheduled_ns: int, now_ns: int, state: int, fault: int, faults_active: int, flags: int,
        sequence: int, task_ns: int,
    ) -> None:  # fmt: skip
        """The tick as a whole."""
        words = self._words
        words[0] = index
        words[1] = scheduled_ns
        words[2] = now_ns
        words[3] = state | fault << 32
        words[4] = faults_active
        words[5] = _pair(flags, sequence)
        words[6] = task_ns

    def axis(
        self, axis: i64, position: float, position_estimate: float, velocity_estimate: float,
        disturbance_estimate: float, innovation: float, setpoint_position: float, setpoint_velocity: float,
        force_requested: float, force: float, stamp_ns: int, saturations: int,
    ) -> None:  # fmt: skip
        """One axis' motion, its following error with it. axis: 0-based."""
        motion, words = self._motion, self._words
        motion[axis] = position
        motion[axis + 4] = position_estimate  # MAX_AXES places each
        motion[axis + 8] = velocity_estimate
        motion[axis + 12] = disturbance_estimate
        motion[axis + 16] = innovation
        motion[axis + 20] = setpoint_position
        motion[axis + 24] = setpoint_velocity
        motion[axis + 28] = position - setpoint_position
        motion[axis + 32] = force_requested
        motion[axis + 36] = force
        words[_STAMP + axis] = stamp_ns
        words[_SATURATIONS + axis] = saturations

    def drives(self, age_ticks: list[int], status: list[int]) -> None:
        """Ticks since the last accepted sample, and the drive's status; one each an axis."""
        if age_ticks != self._age_ticks:
            self._age_ticks = age_ticks[:]
            self._put_pairs(_AGE, age_ticks)
        if status != self._status:
            self._status = status[:]
            self._put_pairs(_STATUS, status)

    def _put_pairs(self, place: int, values: list[int]) -> None:
        for axis, value in enumerate(values):
            word = place + axis // 2
            self._words[word] = _pair(self._words[word], value) if axis & 1 else _pair(value, 0)

    def counters(
        self, port: Sequence[int], rejects: list[int], lost: int, illegal: int, refused: int, floors: int
    ) -> None:
        """Cumulative counters, but for the shell's. port: PortCounters."""
        words = self._words
        for place, count in enumerate(port):
            words[_PORT + place] = count
        if rejects != self._rejects:
            self._rejects = rejects[:]
            for place, count in enumerate(rejects):
                words[_REJECTS + place] = count
        words[_LOST] = lost
        words[_ILLEGAL] = illegal
        words[_ILLEGAL + 1] = refused
        words[_ILLEGAL + 2] = floors

    def spent(self, read: int, estimate: int, control: int, gate: int, send: int) -> None:
        """The shell's: ns that this tick's stages took, to be told in the next record."""
        words = self._words
        words[_SPENT] = _pair(_at_most_u32(read), _at_most_u32(estimate))
        words[_SPENT + 1] = _pair(_at_most_u32(control), _at_most_u32(gate))
        words[_SPENT + 2] = _at_most_u32(send)  # and no run delay

    def missed(self, own: int, host: int, longest: int, run_delay_ns: int) -> None:
        """The shell's: slots lost so far, and the run delay of the tick before that lost some."""
        words = self._words
        words[_MISSED] = own
        words[_MISSED + 1] = host
        words[_MISSED + 2] = longest
        words[_SPENT + 2] = _pair(words[_SPENT + 2], _at_most_u32(run_delay_ns))

    def traffic(
        self, commands: Sequence[tuple[OperatorCommand, bool]], sent: Sequence[Frame], received: Sequence[Frame]
    ) -> np.void:
        """All that went in and out of the tick; the record, which is the same object every time."""
        n_received = len(received)
        self._words[_COUNTS] = len(commands) | n_received << 16 | len(sent) << 32
        if commands:
            self._commands(commands)
        self._frames(0, sent)
        self._frames(MAX_SENT, received)
        self._to_head[:] = self._head
        self._to_motion[:] = self._from_motion
        self._to_rest[n_received][:] = self._rest[n_received]
        return self.record

    def _commands(self, commands: Sequence[tuple[OperatorCommand, bool]]) -> None:
        words, place = self._words, _COMMANDS
        for command, accepted in commands:
            words[place] = _pair(command.kind, accepted)
            words[place + 1] = _bits(command.sequence)
            words[place + 2] = min(max(command.expires_ns, -_HALF_U64), _HALF_U64 - 1)
            place += _COMMAND_WORDS

    def _frames(self, first: int, frames: Sequence[Frame]) -> None:
        """first: of the frames' places; those of `received` are behind those of `sent`."""
        words, place, index = self._words, _SENT + _FRAME_WORDS * first, first
        for can_id, data, flags, stamp_ns in frames:
            length = len(data)
            words[place] = stamp_ns
            words[place + 1] = can_id | length << 32 | flags << 40
            if length & 7:
                data += _PADDING[(length & 7) - 1 :]
            word = place + 2
            for at in range(0, length, 8):
                words[word] = read_i64_le(data, at)
                word += 1
            place += _FRAME_WORDS
            if length != self._lengths[index]:
                while word < place:
                    words[word] = 0  # of an earlier, longer frame
                    word += 1
                self._lengths[index] = length
            index += 1
