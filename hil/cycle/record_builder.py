"""Writing a tick's record, field by field, into the layout of record.py.

This is the one place where numbers are packed by hand. The parts are kept in arrays of machine words and of doubles
(librt.vecs), and copied into the record at the end. Compiled, a number written there takes a few instructions, where
struct.pack_into or a numpy field takes some hundred. The record has about a hundred numbers, so that this is worth a
large part of a tick (docs/what-costs-what.md). Interpreted, both cost about the same.

Rules: one record, written over and over; its parts in any order, and `traffic` last, which puts it together. What is
too large for its field is cut: no number, however absurd, may raise in the control process.
"""

from collections.abc import Callable, Sequence
from struct import Struct
from typing import Any, Final

import numpy as np
from librt.strings import read_i64_le
from librt.vecs import vec
from mypy_extensions import i64

from drivers.frame import Frame
from drivers.native import copy
from drivers.native import path as native
from hil.control.estimator.motion_filter import MotionFilter
from hil.control.laws.base import LawInputs
from hil.cycle.fault_evidence import Evidence
from hil.cycle.goal import Goal
from hil.cycle.record import (
    COMMAND,
    EVERY_AXIS,
    FRAME,
    GOAL,
    MAX_EVIDENCE,
    MAX_READINGS,
    MOTION_FIELDS,
    RECORD,
    RECORD_SIZE,
    REJECT_REASONS,
)
from hil.cycle.tick import OperatorCommand, Tick
from hil.rig.schema import MAX_AXES

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
_EVIDENCE_OF: Final = _word("evidence_of")
_MEASURED: Final = _word("evidence_value")
_MOVING: Final = _word("motion")
_GOALS: Final = _word("goals")
_GOAL_WORDS: Final = GOAL.itemsize // 8
_READINGS: Final = _word("readings")
_READING_AGE: Final = _word("reading_age")
_SENT: Final = _word("sent")
_RECEIVED: Final = _word("received")
_COMMAND_WORDS: Final = COMMAND.itemsize // 8
_PACKED_GOAL: Final = Struct("<IBBHqq4d4ddIIQ")  # GOAL
_PACKED_FRAME: Final = Struct("<qq64s")  # FRAME; identifier, length and flags in one
_FRAME_BYTES: Final = FRAME.itemsize
_copy: Final = copy
_record: Final[Callable[..., None] | None] = native.record if native else None

_MAX_I16: Final = 0x7FFF
_MAX_U16: Final = 0xFFFF
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


def _at_most_u8(value: int) -> int:
    return value if 0 <= value < 0xFF else 0xFF


def _within_i64(value: int) -> int:
    return min(max(value, -_HALF_U64), _HALF_U64 - 1)


class RecordBuilder:
    """The record of the present tick; the same object every time."""

    def __init__(self, n_axes: int) -> None:
        self._words: vec[i64] = vec[i64]([0] * _SENT)  # all but the motion fields and the frames
        self._motion: vec[float] = vec[float]([0.0] * (_STAMP - _MOTION))
        self._flags = 0
        self._measured: vec[float] = vec[float]([0.0] * (2 * MAX_EVIDENCE))  # values, then limits
        self._n_evidence = self._evidence_total = 0
        self._goal_counts: Sequence[int] = (0, 0, 0, 0)
        self.word = self.goals = 0  # motion word and number of goals in the record
        # What the words hold already: it seldom changes.
        self._age_ticks = self._status = [0] * n_axes
        self._rejects = [0] * REJECT_REASONS
        buffer = bytearray(RECORD_SIZE)
        self.record: np.void = np.frombuffer(buffer, dtype=RECORD)[0]
        record, words = memoryview(buffer), memoryview(self._words).cast("B")
        self._buffer, self._words_bytes, self._put_together = record, words, _record
        begin, end = 8 * _MOTION, 8 * _STAMP
        # The record's parts, each with what it is a copy of.
        self._to_head, self._head = record[:begin], words[:begin]
        self._to_motion, self._from_motion = record[begin:end], memoryview(self._motion).cast("B")
        self._to_measured = record[8 * _MEASURED : 8 * (_MEASURED + 2 * MAX_EVIDENCE)]
        self._from_measured = memoryview(self._measured).cast("B")
        self._readings: vec[float] = vec[float]([0.0] * MAX_READINGS)
        self._has_readings = False
        self._to_readings = record[8 * _READINGS : 8 * (_READINGS + MAX_READINGS)]
        self._from_readings = memoryview(self._readings).cast("B")
        self._to_rest, self._rest = record[end : 8 * _SENT], words[end:]

    def tick(self, tick: Tick, state: int, fault: int, faults_active: int, *, sending: bool) -> None:
        """The tick, the state it ended in, and its faults."""
        words = self._words
        words[0] = tick.index
        words[1] = tick.scheduled_ns
        words[2] = tick.now_ns
        words[3] = state | fault << 32
        words[4] = faults_active
        self._flags = tick.stop | tick.recorder_ok << 1 | tick.realtime_ok << 2 | tick.rig_ok << 3 | sending << 4
        self._flags |= tick.estop << 5

    def progress(self, sequence: int, task_ns: int) -> None:
        """Sequence number of the newest command, and time on the task's clock; after `tick`."""
        self._words[5] = _pair(self._flags, sequence)
        self._words[6] = task_ns

    def axis(self, axis: i64, inputs: LawInputs, motion: MotionFilter, velocity: float, stamp_ns: int) -> None:
        """One axis' motion, its following error with it. axis: 0-based. velocity: to be shown, m/s. stamp_ns: instant
        that the motion belongs to.
        """
        fields, reference = self._motion, inputs.sample
        position: float = inputs.position
        setpoint: float = reference.position
        fields[axis] = position
        fields[axis + MAX_AXES] = motion.position
        fields[axis + 2 * MAX_AXES] = velocity
        fields[axis + 3 * MAX_AXES] = motion.disturbance
        fields[axis + 4 * MAX_AXES] = motion.innovation
        fields[axis + 5 * MAX_AXES] = setpoint
        fields[axis + 6 * MAX_AXES] = reference.velocity
        fields[axis + 7 * MAX_AXES] = position - setpoint
        self._words[_STAMP + axis] = stamp_ns

    def estimate(self, axis: i64, position: float, velocity: float) -> None:
        """What the law was told of one axis, m and m/s, in place of what `axis` put there."""
        self._motion[axis + MAX_AXES] = position
        self._motion[axis + 2 * MAX_AXES] = velocity

    def force(self, axis: i64, requested: float, applied: float, saturations: int) -> None:
        """Force of one axis, N, and how often the gate has changed it."""
        self._motion[axis + 8 * MAX_AXES] = requested
        self._motion[axis + 9 * MAX_AXES] = applied
        self._words[_SATURATIONS + axis] = saturations

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

    def counters(self, port: Sequence[int], rejects: list[int], lost: int, illegal: int, refused: int) -> None:
        """Cumulative counters, except the law's and the shell's. port: PortCounters."""
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

    def law_floors(self, floors: int) -> None:
        """How often the law has held a denominator at its floor."""
        self._words[_ILLEGAL + 2] = floors

    def evidence(self, found: Sequence[Evidence]) -> None:
        """What the detectors measured in this tick, the gravest first; the first MAX_EVIDENCE are kept, all are
        counted.
        """
        words, measured = self._words, self._measured
        for place, (fault, axis, value, limit) in enumerate(found[:MAX_EVIDENCE]):
            word = _EVIDENCE_OF + place // 2
            what = fault | (axis & EVERY_AXIS) << 16
            words[word] = _pair(words[word], what) if place & 1 else _pair(what, 0)
            measured[place] = value
            measured[place + MAX_EVIDENCE] = limit
        self._n_evidence = len(found)
        self._evidence_total += len(found)
        words[_ILLEGAL + 3] = self._evidence_total

    def readings(self, values: list[float], ages: list[int]) -> None:
        """Of the sensors, by channel, each in its unit and in ticks."""
        packed = 0
        for channel, value in enumerate(values):
            self._readings[channel] = value
            age = ages[channel]
            packed |= (age if age < _MAX_U16 else _MAX_U16) << 16 * channel
        self._words[_READING_AGE] = _bits(packed)
        self._words[_READING_AGE + 1] = _bits(packed >> 64)
        self._has_readings = True

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

    def motion(self, word: int, counts: Sequence[int], goals: Sequence[tuple[Goal, int]]) -> None:
        """The motion word; number of the goal taken last, limited, superseded and refused so far; goals of the tick,
        each with what refused it.
        """
        words = self._words
        self.word, self.goals = word, len(goals)
        words[_MOVING] = word | len(goals) << 24
        if not goals and counts == self._goal_counts:
            return
        self._goal_counts = counts
        words[_MOVING + 1] = _pair(0, goals[-1][0].lease) if goals else words[_MOVING + 1]
        words[_MOVING + 2] = _pair(counts[0], counts[1])
        words[_MOVING + 3] = _pair(counts[2], counts[3])
        for place, (goal, refusal) in enumerate(goals):
            packed = _PACKED_GOAL.pack(
                goal.number & _MAX_U32, _at_most_u8(goal.kind), _at_most_u8(goal.mask), goal.flags & 0xFFFF,
                _within_i64(goal.due_ns), _within_i64(goal.valid_ns), *goal.position, *goal.velocity, goal.speed,
                goal.lease & _MAX_U32, refusal, 0,
            )  # fmt: skip
            at = _GOALS + _GOAL_WORDS * place
            for k in range(_GOAL_WORDS):
                words[at + k] = read_i64_le(packed, 8 * k)

    def homing(self, told: int) -> None:
        """What is being done to home the axes, and which are not homed. Behind `motion`."""
        words = self._words
        words[_MOVING] = words[_MOVING] & ~0xFF00 | told << 8

    def decided(self, outputs: int, phase: int, cell: int, limited: int) -> None:
        """Of a motion that decides: the outputs set, its phase and cell, and what was brought within limits so far.
        Behind `motion`.
        """
        words = self._words
        words[_MOVING] = words[_MOVING] & 0xFF00FFFF | outputs << 16 | phase << 32
        words[_MOVING + 1] = words[_MOVING + 1] & ~0xFFFFFFFF | cell
        words[_MOVING + 2] = words[_MOVING + 2] & 0xFFFFFFFF | (limited & 0x7FFFFFFF) << 32

    def traffic(
        self, commands: Sequence[tuple[OperatorCommand, bool]], sent: Sequence[Frame], received: Sequence[Frame]
    ) -> np.void:
        """All that went in and out of the tick; the record, which is the same object every time."""
        n_received = len(received)
        n_evidence = self._n_evidence
        self._words[_COUNTS] = (
            len(commands)
            | n_received << 16
            | len(sent) << 32
            | (n_evidence if n_evidence < _MAX_I16 else _MAX_I16) << 48
        )
        if commands:
            self._commands(commands)
        if self._put_together is None:
            _copy(self._to_head, 0, self._head)
            _copy(self._to_motion, 0, self._from_motion)
            _copy(self._to_rest, 0, self._rest)
            self._frames(8 * _SENT, sent)
            self._frames(8 * _RECEIVED, received)
        else:
            self._put_together(
                self._buffer, self._words_bytes, self._from_motion, 8 * _MOTION, 8 * _STAMP,
                8 * _SENT, sent, 8 * _RECEIVED, received,
            )  # fmt: skip
        if self._has_readings:
            _copy(self._to_readings, 0, self._from_readings)
        if n_evidence:
            _copy(self._to_measured, 0, self._from_measured)
            self._n_evidence = 0
        return self.record

    def _commands(self, commands: Sequence[tuple[OperatorCommand, bool]]) -> None:
        words, place = self._words, _COMMANDS
        for command, accepted in commands:
            words[place] = _pair(command.kind, accepted)
            words[place + 1] = _bits(command.sequence)
            words[place + 2] = min(max(command.expires_ns, -_HALF_U64), _HALF_U64 - 1)
            place += _COMMAND_WORDS

    def _frames(self, at: int, frames: Sequence[Frame]) -> None:
        """The frames into the record, from byte `at` on."""
        for can_id, data, flags, stamp_ns in frames:
            _PACKED_FRAME.pack_into(self._buffer, at, stamp_ns, can_id | len(data) << 32 | flags << 40, data)
            at += _FRAME_BYTES
