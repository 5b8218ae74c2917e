"""What a tick does with its frames, in C against its twins in Python: the same bytes, whatever comes."""

import ctypes
import itertools
import math
import socket
import struct
from collections.abc import Callable
from time import monotonic_ns
from types import ModuleType

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import native
from drivers.bus.counters import PortCounters
from drivers.bus.receive_block import _SLOT_BYTES as SLOT_BYTES
from drivers.bus.receive_block import ReceiveBlock
from drivers.bus.recvmmsg import CONTROL_LENGTH_AT, HEADER_BYTES, SLOTS, SO_TIMESTAMPNS, STAMPED, MessageMemory
from drivers.bus.recvmmsg import _receive as plain_receive
from drivers.config import BusConfig, Wiring
from drivers.families.stage import stage_fd
from drivers.frame import BRS, CANFD_MTU, ERROR, FD, Frame, from_bytes, to_bytes
from drivers.protocols.base import EVERY_STATUS, Sample
from hil.cycle.inbox import Inbox
from hil.cycle.record import MAX_RECEIVED, MAX_SENT
from hil.cycle.record_builder import RecordBuilder

SECOND = 10**9
pytestmark = pytest.mark.long


def outcome(call: Callable[..., object], *arguments: object) -> object:
    """What a call gives, or the kind of exception it ends in."""
    try:
        return call(*arguments)
    except Exception as error:
        return type(error)


U16, U32 = st.integers(0, 0xFFFF), st.integers(0, 0xFFFFFFFF)
STAMPS = st.integers(0, 2**62)


@given(data=st.binary(min_size=16, max_size=16), can_id=U32, received=STAMPS, sound=st.booleans())
def test_feedback_is_read_alike(c: ModuleType, data: bytes, can_id: int, received: int, sound: bool) -> None:
    if sound:
        data = data[:12] + stage_fd.crc32(data[:12], can_id).to_bytes(4, "little")
    assert c.feedback(data, can_id, received) == stage_fd._plain_feedback(data, can_id, received)
    assert not sound or c.feedback(data, can_id, received) is not None


FORCES = st.floats(-1e30, 1e30) | st.sampled_from([0.0, -0.0, 5e-324, 1e-45, math.nextafter(20.0, 21.0)])


FORCE = FORCES | st.sampled_from([math.nan, math.inf, -math.inf])
LIMIT = st.sampled_from([20.0, 1e31, 0.0])


@given(can_id=U32, forces=st.lists(FORCE, max_size=5), limits=st.tuples(*4 * [LIMIT]), sequence=U16, flags=U16)
def test_a_command_is_written_or_refused_alike(
    c: ModuleType, can_id: int, forces: list[float], limits: tuple[float, ...], sequence: int, flags: int
) -> None:
    arguments = (can_id, forces, limits, sequence, flags)
    assert c.command(*arguments) == stage_fd._plain_command(*arguments)


LENGTHS = st.sampled_from([0, 1, 7, 8, 12, 16, 24, 64])
FRAMES = st.builds(
    Frame,
    st.integers(0, 0x7FF) | st.sampled_from([0x80000100, ERROR | 1]),
    LENGTHS.flatmap(lambda n: st.binary(min_size=n, max_size=n)),
    st.sampled_from([FD, FD | BRS, FD | 0x30]),
    STAMPS,
)


WIRING = Wiring(BusConfig(protocol="stage_fd"), 3, (20.0,) * 3)
HOST, DEVICE = stage_fd.StageFdHost(WIRING), stage_fd.StageFdDevice(WIRING)
I32 = st.integers(-(2**31), 2**31 - 1)


def answer(axis: int, numbers: tuple[int, int, int, int], received_ns: int, damage: int) -> Frame:
    """An axis' answer, received then; damage: 1 to 4, in one of its parts."""
    position, stamp, status, sequence = numbers
    data = stage_fd.FEEDBACK.pack(position, stamp, status, sequence, 0)[:12]
    can_id = DEVICE.encode_feedback(Sample(axis, 0, 0, 0, 0)).can_id
    data += stage_fd.crc32(data, can_id + (damage == 1)).to_bytes(4, "little")
    flags = (FD | BRS, FD | BRS, 0, FD, FD | BRS)[damage]
    return Frame(can_id, data[: 12 if damage == 4 else 16], flags, received_ns)


TOLD = (
    "samples", "fresh", "received_ns", "age", "heard", "rejects", "bad_frames", "suspect_axis", "late", "lost",
    "foreign_id", "differ_axis", "useless_now",
)  # fmt: skip
NUMBERS = st.tuples(I32, U32, st.integers(0, 1023) | U16, st.integers(0, 3))
ANSWERS = st.builds(answer, st.integers(0, 2) | st.just(3), NUMBERS, STAMPS, st.sampled_from([0] * 12 + [1, 2, 3, 4]))


@given(frames=st.lists(ANSWERS, max_size=5) | st.lists(ANSWERS | FRAMES, max_size=5))
def test_the_first_answers_are_read_alike_and_the_rest_left_to_be_decoded(c: ModuleType, frames: list[Frame]) -> None:
    outcomes = [HOST.decode(frame) for frame in frames]
    sound = list(itertools.takewhile(lambda outcome: isinstance(outcome, Sample), outcomes))
    rows = list(struct.iter_unpack("<6q", c.answers(frames, HOST._feedback_id, 3, EVERY_STATUS)))
    assert [Sample(*fields) for *fields, _ in rows] == sound
    assert [row[5] for row in rows] == [frame.timestamp_ns for frame in frames[: len(sound)]]


@given(ticks=st.lists(st.lists(ANSWERS, max_size=4), max_size=6))
def test_an_inbox_is_the_same_whoever_reads(c: ModuleType, ticks: list[list[Frame]]) -> None:
    plain, fast = Inbox(HOST, 20), Inbox(HOST, 20)
    plain._answers, fast._answers = None, lambda frames: c.answers(frames, HOST._feedback_id, 3, EVERY_STATUS)
    for sequence, frames in enumerate(ticks):
        plain.collect(frames, sequence)
        fast.collect(frames, sequence)
        assert [getattr(fast, name) for name in TOLD] == [getattr(plain, name) for name in TOLD]


@given(st.lists(st.integers(), max_size=5))
def test_a_tuple_of_any_class_is_made_alike(c: ModuleType, items: list[int]) -> None:
    for kind in (tuple, Frame, PortCounters):
        made = c.tuple_as(kind, items)
        assert (type(made), made) == (kind, tuple.__new__(kind, items))
    assert outcome(c.tuple_as, list, items) is TypeError
    assert outcome(c.tuple_as, Frame, 3) is TypeError


@given(ticks=st.lists(st.tuples(st.lists(FRAMES, max_size=MAX_SENT), st.lists(FRAMES, max_size=MAX_RECEIVED))))
def test_a_record_keeps_frames_alike_tick_by_tick(c: ModuleType, ticks: list[tuple[list[Frame], list[Frame]]]) -> None:
    plain = RecordBuilder(4)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hil.cycle.record_builder._record", c.record)
        fast = RecordBuilder(4)
    for sent, received in ticks:
        expected = plain.traffic((), sent, received).tobytes()
        assert fast.traffic((), sent, received).tobytes() == expected


class Messages:
    """A memory in which messages stand as the kernel would leave them, with a stamp and some control data."""

    def __init__(self, packets: list[Frame], stamps: list[int], controls: list[int]) -> None:
        self.block = ReceiveBlock(CANFD_MTU)
        self.block.expect(len(FEEDBACK.data), FEEDBACK.flags)
        self.block.count = len(packets)
        headers, plain, _, slots = self.block._parts[len(packets)]
        headers[:] = plain
        for number, (packet, stamp, control) in enumerate(zip(packets, stamps, controls, strict=True)):
            at = number * HEADER_BYTES + CONTROL_LENGTH_AT
            headers[at : at + 8] = struct.pack("@N", control)
            raw = to_bytes(packet)
            raw += struct.pack("@Niill", STAMPED, socket.SOL_SOCKET, SO_TIMESTAMPNS, *divmod(stamp, SECOND))
            slots[number * SLOT_BYTES : number * SLOT_BYTES + len(raw)] = raw

    def plain(self, *times: int) -> tuple[list[Frame] | None, bool]:
        """Frames, and whether the headers are ready for the next call."""
        found = self.block._plain_frames(self.block.count, *times)
        return found, self._is_fresh()

    def native(self, c: ModuleType, *times: int) -> tuple[list[Frame] | None, bool]:
        """The same in C."""
        block = self.block
        of_frame = (block._size, block._head, block._flags)
        found = c.frames(block._headers, block._slots, block.count, Frame, *of_frame, *times)
        return found, self._is_fresh()

    def _is_fresh(self) -> bool:
        used, _, fresh, _ = self.block._parts[self.block.count]
        return bytes(used) == fresh


FEEDBACK = Frame(0x101, bytes(range(16)), FD | BRS)


@given(
    others=st.lists(st.just(FEEDBACK) | st.just(FEEDBACK._replace(can_id=0x104)) | FRAMES, min_size=1, max_size=6),
    ages=st.lists(st.integers(-1000, 2 * SECOND) | st.integers(0, 10**6), min_size=6, max_size=6),
    controls=st.lists(st.sampled_from([STAMPED] * 9 + [0, 64]), min_size=6, max_size=6),
    window=st.integers(0, 2 * SECOND) | st.integers(0, 10**6),
    latest=st.integers(0, 3 * SECOND),
    offset=st.integers(10**18, 10**18 + 2 * SECOND),
)
def test_frames_are_found_alike_or_left_to_the_slow_path_alike(
    c: ModuleType, others: list[Frame], ages: list[int], controls: list[int], window: int, latest: int, offset: int
) -> None:
    n = len(others)
    stamps = [latest + offset - age for age in ages[:n]]
    times = (offset, latest - window, latest)
    left, right = (Messages(others, stamps, controls[:n]) for _ in range(2))
    assert right.native(c, *times) == left.plain(*times)


def test_a_ticks_answers_take_the_fast_path(c: ModuleType) -> None:
    answers = [FEEDBACK._replace(can_id=0x101 + axis) for axis in range(4)]
    stamps = [10**18 + 2_000_000 + 1_500 * axis for axis in range(4)]
    times = (10**18, 1_900_000, 2_100_000)
    found, fresh = Messages(answers, stamps, [STAMPED] * 4).native(c, *times)
    assert found == [
        answer._replace(timestamp_ns=stamp)
        for answer, stamp in zip(answers, (2_000_000, 2_001_000, 2_003_000, 2_004_000), strict=True)
    ]
    assert {type(frame) for frame in found} == {Frame}
    assert fresh


def test_what_a_socket_has_is_received_alike(c: ModuleType) -> None:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with near, far:
        near.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        near.setblocking(False)
        memory = MessageMemory(CANFD_MTU, CANFD_MTU)
        assert c.receive(near.fileno(), memory.headers, SLOTS) == 0
        for number in range(3):
            far.send(to_bytes(FEEDBACK._replace(can_id=number)))
        assert c.receive(near.fileno(), memory.headers, SLOTS) == 3
        assert bytes(memory.headers[: 3 * HEADER_BYTES]) == memory.plain[: 3 * HEADER_BYTES]
        received = [from_bytes(bytes(memory.slots[k * SLOT_BYTES :][:CANFD_MTU])) for k in range(3)]
        assert received == [FEEDBACK._replace(can_id=number) for number in range(3)]
    descriptor = near.fileno()
    assert descriptor == -1
    plain = outcome(plain_receive, descriptor, ctypes.byref(memory._headers), SLOTS)
    assert outcome(c.receive, descriptor, memory.headers, SLOTS) is plain is OSError


def test_what_does_not_fit_is_refused_and_nothing_written(c: ModuleType) -> None:
    memory = memoryview(bytearray(160))
    words, motion = bytes(160), bytes(8)
    for edges, sent, received in (
        ((8, 16, 80), [FEEDBACK, FEEDBACK], []),
        ((8, 16, 80), [], [FEEDBACK]),
        ((8, 16, 80), [Frame(1, bytes(65))], []),
        ((-1, 7, 80), [], []),
        ((16, 8, 80), [], []),
        ((8, 17, 80), [], []),
        ((8, 16, 161), [], []),
    ):
        assert outcome(c.record, memory, words, motion, *edges, sent, 81, received) is ValueError
    assert outcome(c.record, memory, words, motion, 8, 16, 80, [(1, b"", 0)], 80, []) is TypeError
    assert outcome(c.record, words, words, motion, 8, 16, 80, [], 80, []) is BufferError
    assert outcome(c.copy, memory, 150, bytes(11)) is ValueError
    assert outcome(native._plain_copy, memory, 150, bytes(11)) is ValueError
    assert outcome(c.copy, bytes(4), 0, b"1") is BufferError
    assert outcome(c.feedback, bytes(15), 1, 0) is ValueError
    assert outcome(c.feedback, bytes(16), "1", 0) is TypeError
    assert outcome(c.command, 1, 0.0) is TypeError
    assert outcome(c.command, 1, [0.0], (1.0,), 0, 0) is TypeError
    assert outcome(c.command, 1, ["much"], (1.0,) * 4, 0, 0) is TypeError
    assert outcome(c.answers, None, 1, 4, 0) is TypeError
    assert outcome(c.receive, 0, memory, SLOTS) is ValueError
    assert outcome(c.frames, memory, memory, 3, Frame, 72, 16, 4, 0, 0, 0) is ValueError
    assert outcome(c.frames, memory, memory, 1, object, 72, 16, 4, 0, 0, 0) is TypeError
    assert not any(memory)


@given(st.binary(max_size=40), st.integers(0, 60))
def test_bytes_are_copied_alike(c: ModuleType, data: bytes, begin: int) -> None:
    one, other = bytearray(64), bytearray(64)
    kinds = [outcome(copy, memoryview(to), begin, data) for copy, to in ((c.copy, one), (native._plain_copy, other))]
    assert kinds[0] == kinds[1]
    assert one == other


def test_both_sleep_to_the_instant_and_none_sleeps_to_one_that_is_over(c: ModuleType) -> None:
    for sleep in (c.sleep_until, c.sleep_alone):
        deadline = monotonic_ns() + 2_000_000
        sleep(deadline)
        assert monotonic_ns() >= deadline
        sleep(0)
        assert outcome(sleep, "soon") is TypeError
