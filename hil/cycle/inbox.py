"""From received frames to at most one trusted sample per axis and tick: layout, checksum, sequence, age."""

from collections.abc import Callable, Sequence
from typing import Final

from librt.strings import read_i64_le
from mypy_extensions import i64

from drivers.frame import ECHO, Frame, segment_of
from drivers.protocols.base import HostProtocol, Reject, Sample, own_ids
from hil.cycle.output_gate import OutputGate
from hil.cycle.readings import Readings

SUSPICIOUS = frozenset(
    {
        Reject.WRONG_LENGTH,
        Reject.WRONG_FORMAT,
        Reject.BAD_CHECKSUM,
        Reject.INVALID_VALUE,
        Reject.STALE,
        Reject.DUPLICATE,
    }
)


_OWN_ECHO: Final = int(Reject.OWN_ECHO)
_NOT_EXPECTED: Final = -2  # no sample has this sequence number
_WORD: Final = 8
_ANSWER: Final = 6 * _WORD  # bytes of an answer that was read in C: a Sample's fields, and when it came


class Inbox:
    """The newest sample of every axis, and counters for everything that was not one.

    `fresh[i]`: this tick brought axis i's answer to the latest command. `age[i]`: ticks since it last did.
    `bad_frames`: leaky bucket of suspicious frames, one forgiven every `leak_ticks`. What a checksum has passed is no
    line noise, and is never forgiven. readings, outputs: of the rig's sensors and output nodes, whose frames no layout
    knows; None: it has none.
    """

    def __init__(
        self,
        protocol: HostProtocol,
        leak_ticks: int,
        readings: Readings | None = None,
        outputs: OutputGate | None = None,
    ) -> None:
        n = protocol.n_axes
        self._readings = readings
        self._outputs = outputs
        self._decode = protocol.decode
        # Of layouts whose frames are read in C, as many of a tick as are usual (drivers/families/stage/stage_fd.py).
        self._answers: Callable[[Sequence[Frame]], bytes] | None = getattr(protocol, "answers", None)
        self._own = own_ids(protocol)
        self._checked = protocol.checksum
        self._unforgiven = 0  # of bad_frames
        self._modulus = protocol.sequence_modulus
        self._leak_ticks = leak_ticks
        self._since_leak = 0
        self._last_sequence = [-1] * n
        self.samples: list[Sample | None] = [None] * n
        self.fresh = [False] * n
        self.received_ns = [0] * n  # when the newest sample came
        self.age = [0] * n
        self.heard = [False] * n
        self.rejects = [0] * len(Reject)
        self.bad_frames = 0
        self.suspect_axis = -1  # whose answers all of those were; -1: of several, or nobody knows
        self.late = 0
        self.lost = 0
        self.foreign_id = -1  # identifier of ours in which another node spoke in this tick
        self.differ_axis = -1  # whose two valid answers to one command differ, in this tick
        self.useless_now = 0  # frames of this tick that no sample, echo or first service of its identifier explains
        self._served: set[tuple[int, int]] = set()  # segment and identifier of the services told in this tick

    def forget(self) -> None:
        """After a reset: whatever was heard before counts no more."""
        n = len(self.heard)
        self._last_sequence = [-1] * n
        self.heard = [False] * n
        self.age = [0] * n
        self.bad_frames = self._unforgiven = 0
        if self._readings is not None:
            self._readings.forget()

    def collect(self, frames: Sequence[Frame], sent_sequence: int) -> None:
        """Sort one tick's frames; `sent_sequence` is that of the newest command sent, -1 before the first."""
        self.useless_now = 0
        self._served.clear()
        self.foreign_id = self.differ_axis = -1
        for axis in range(len(self.fresh)):
            self.fresh[axis] = False
        read = b"" if self._answers is None else self._answers(frames)
        self._take_read(read, sent_sequence)
        rest = len(read) // _ANSWER
        if rest < len(frames):
            self._sort(frames[rest:], sent_sequence)
        if sent_sequence >= 0:
            self._grow_older()

    def _take_read(self, read: bytes, sent_sequence: int) -> None:
        """Answers that were read in C, and own echoes, which have no axis."""
        for begin in range(0, len(read), _ANSWER):
            at: i64 = begin
            if read_i64_le(read, at) < 0:
                self.rejects[_OWN_ECHO] += 1
                continue
            sample = Sample(
                read_i64_le(read, at), read_i64_le(read, at + _WORD), read_i64_le(read, at + 2 * _WORD),
                read_i64_le(read, at + 3 * _WORD), read_i64_le(read, at + 4 * _WORD),
            )  # fmt: skip
            self._take(sample, read_i64_le(read, at + 5 * _WORD), sent_sequence)

    def _take(self, sample: Sample, received_ns: int, sent_sequence: int) -> None:
        """An answer; mostly what is due."""
        axis, modulus = sample.axis, self._modulus
        self.received_ns[axis] = received_ns
        expected = sent_sequence % modulus if modulus and sent_sequence >= 0 else _NOT_EXPECTED
        if sample.sequence == expected and self._last_sequence[axis] != expected:
            self.samples[axis] = sample
            self._last_sequence[axis] = expected
            self.fresh[axis] = True
        else:
            self._accept(sample, sent_sequence)

    def _sort(self, frames: Sequence[Frame], sent_sequence: int) -> None:
        """One by one, whatever they are."""
        decode = self._decode
        for frame in frames:
            outcome = decode(frame)
            if isinstance(outcome, Sample):
                self._take(outcome, frame.timestamp_ns, sent_sequence)
            elif isinstance(outcome, tuple):
                for sample in outcome:
                    self._accept(sample, sent_sequence)
            elif self._readings is not None and self._readings.knows(frame):
                refused = self._readings.take(frame)
                if refused is not None:
                    self._reject(refused)
                    self._excuse(refused, frame)
            elif self._outputs is not None and self._outputs.knows(frame):
                said = self._outputs.take(frame)
                self._reject(said)
                self._excuse(said, frame)
            else:
                if not frame.flags & ECHO and frame.can_id in self._own[segment_of(frame)]:
                    self.foreign_id = frame.can_id
                self._reject(outcome)
                self._excuse(outcome, frame)

    def oldest(self) -> int:
        """Ticks since the sample of the axis that has waited longest."""
        oldest = 0
        for age in self.age:
            if age > oldest:
                oldest = age
        return oldest

    def _accept(self, sample: Sample, sent_sequence: int) -> None:
        axis = sample.axis
        if self._modulus:
            behind = (sent_sequence - sample.sequence) % self._modulus  # 0: what is due, however old the one before is
            previous = self._last_sequence[axis]
            if previous >= 0:
                newer = (sample.sequence - previous) % self._modulus
                if newer == 0:
                    self._repeated(sample)
                    return
                if behind and newer > self._modulus // 2:
                    self._stale(axis)
                    return
            if sent_sequence < 0 or behind > self._modulus // 2:
                self._stale(axis)  # it answers a command never sent
                return
            self._last_sequence[axis] = sample.sequence
            if behind:
                # True, but of an earlier tick: the filter has moved past it. Not suspicious: hosts do stall.
                self.late += 1
                return
        elif self.fresh[axis]:
            self.late += 1  # without a sequence number, which command it answers cannot be told: the newest wins
        self.samples[axis] = sample
        self.fresh[axis] = True

    def _repeated(self, sample: Sample) -> None:
        """A second answer to a command. CAN may repeat a frame; one that says something else is of another node, and
        neither can be believed.
        """
        taken = self.samples[sample.axis]
        if taken is not None and taken.sequence == sample.sequence and taken != sample:
            self.fresh[sample.axis] = False
            self.differ_axis = sample.axis
        self._reject(Reject.DUPLICATE, sample.axis)

    def _stale(self, axis: int) -> None:
        """Before the first answer, those to an earlier process' commands still come."""
        self._reject(Reject.STALE, axis)
        self._unforgiven += self._checked and self.heard[axis]

    def _reject(self, reason: Reject, axis: int = -1) -> None:
        self.rejects[reason] += 1
        self.useless_now += 1
        if reason in SUSPICIOUS:
            self.suspect_axis = axis if not self.bad_frames or self.suspect_axis == axis else -1
            self.bad_frames += 1
            self._unforgiven += self._checked and reason is Reject.INVALID_VALUE

    def _excuse(self, reason: Reject, frame: Frame) -> None:
        """What we sent ourselves is no flood, and each identifier may serve once a tick: drives that are reset together
        send their answer, heartbeat and boot-up in one, whatever their number.
        """
        if reason is Reject.SERVICE:
            sender = (segment_of(frame), frame.can_id)
            if sender in self._served:
                return
            self._served.add(sender)
        elif reason is not Reject.OWN_ECHO:
            return
        self.useless_now -= 1

    def _grow_older(self) -> None:
        age, heard = self.age, self.heard
        for axis, fresh in enumerate(self.fresh):
            if fresh:
                age[axis] = 0
                heard[axis] = True
            else:
                age[axis] += 1
                self.lost += heard[axis]
        self._since_leak += 1
        if self._since_leak >= self._leak_ticks:
            self._since_leak = 0
            if self.bad_frames > self._unforgiven:
                self.bad_frames -= 1
