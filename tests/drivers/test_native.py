"""What a tick does with its frames, in C against its twins in Python: the same bytes, whatever comes."""

import ctypes
import importlib.util
import math
import shutil
import socket
import struct
import subprocess
import sysconfig
from collections.abc import Callable
from pathlib import Path
from time import monotonic_ns
from types import ModuleType

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import native
from drivers.bus.receive_block import _SLOT_BYTES as SLOT_BYTES
from drivers.bus.receive_block import ReceiveBlock
from drivers.bus.recvmmsg import CONTROL_LENGTH_AT, HEADER_BYTES, SLOTS, SO_TIMESTAMPNS, STAMPED, MessageMemory
from drivers.bus.recvmmsg import _receive as plain_receive
from drivers.families.stage import stage_fd
from drivers.frame import BRS, CANFD_MTU, ERROR, FD, Frame, from_bytes, to_bytes
from hil.cycle.record import MAX_RECEIVED, MAX_SENT
from hil.cycle.record_builder import RecordBuilder
from tests.support.paths import ROOT

SOURCE = ROOT / "drivers" / "native" / "path.c"
FLAGS = ("-O2", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared", "-ffp-contract=off")
SECOND = 10**9
missing = shutil.which("cc") is None or not Path(sysconfig.get_path("include"), "Python.h").exists()
pytestmark = [pytest.mark.long, pytest.mark.skipif(missing, reason="no C compiler, or no headers of Python")]


@pytest.fixture(scope="module")
def c(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    """The extension, compiled from its source."""
    built = tmp_path_factory.mktemp("native") / "path.so"
    include = sysconfig.get_path("include")
    subprocess.run(["cc", *FLAGS, "-I", include, "-o", str(built), str(SOURCE)], check=True)
    spec = importlib.util.spec_from_file_location("path", built)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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


@given(can_id=U32, force=st.tuples(FORCES, FORCES, FORCES, FORCES), sequence=U16, flags=U16)
def test_a_command_is_written_alike(
    c: ModuleType, can_id: int, force: tuple[float, float, float, float], sequence: int, flags: int
) -> None:
    assert c.command(can_id, *force, sequence, flags) == stage_fd._plain_command(can_id, *force, sequence, flags)


LENGTHS = st.sampled_from([0, 1, 7, 8, 12, 16, 24, 64])
FRAMES = st.builds(
    Frame,
    st.integers(0, 0x7FF) | st.sampled_from([0x80000100, ERROR | 1]),
    LENGTHS.flatmap(lambda n: st.binary(min_size=n, max_size=n)),
    st.sampled_from([FD, FD | BRS, FD | 0x30]),
    STAMPS,
)


@given(ticks=st.lists(st.tuples(st.lists(FRAMES, max_size=MAX_SENT), st.lists(FRAMES, max_size=MAX_RECEIVED))))
def test_a_record_keeps_frames_alike_tick_by_tick(c: ModuleType, ticks: list[tuple[list[Frame], list[Frame]]]) -> None:
    plain = RecordBuilder(4)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hil.cycle.record_builder._keep_frames", c.keep_frames)
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
    assert outcome(c.keep_frames, memory, 1, [FEEDBACK, FEEDBACK]) is ValueError
    assert outcome(c.keep_frames, memory, -1, [FEEDBACK]) is ValueError
    assert outcome(c.keep_frames, memory, 0, [(1, b"", 0)]) is TypeError
    assert outcome(c.keep_frames, memory, 0, [Frame(1, bytes(65))]) is ValueError
    assert outcome(c.copy, memory, 150, bytes(11)) is ValueError
    assert outcome(native._plain_copy, memory, 150, bytes(11)) is ValueError
    assert outcome(c.copy, bytes(4), 0, b"1") is BufferError
    assert outcome(c.feedback, bytes(15), 1, 0) is ValueError
    assert outcome(c.feedback, bytes(16), "1", 0) is TypeError
    assert outcome(c.command, 1, 0.0) is TypeError
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
