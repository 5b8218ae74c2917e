"""The Port: what a bus does to a control loop ends in a counter, never in an exception or a wait.

A pair of sockets stands in for the CAN socket, so that error frames and failing calls are fed in as the bytes and
errno values the kernel delivers; the same Port is run on real SocketCAN in the VM lane and on the local bus in
test_local_bus.py.
"""

import errno
import socket
import struct
import time
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.bus import port as bus_module
from drivers.bus import receive_block
from drivers.bus.port import BusState, EchoingPort, Port, PortCounters
from drivers.bus.receive_block import ReceiveBlock
from drivers.bus.recvmmsg import CONTROL_BYTES, HEADER_BYTES, SLOTS, SO_RXQ_OVFL, SO_TIMESTAMPNS, STAMPED
from drivers.frame import BRS, CANFD_MTU, ECHO, ERROR, ESI, EXTENDED, FD, REMOTE, Frame, to_bytes
from tests.support.cable import Cable

COMMAND = Frame(0x080, bytes(range(24)), FD | BRS)
FEEDBACK = Frame(0x100, bytes(range(16)), FD | BRS)
TOO_LONG = to_bytes(FEEDBACK)[:4] + bytes((65,)) + to_bytes(FEEDBACK)[5:]
ORDINARY_AND_NOT = [
    *(to_bytes(FEEDBACK._replace(can_id=0x100 + axis)) for axis in range(4)),
    *(to_bytes(FEEDBACK._replace(can_id=can_id)) for can_id in (0x100 | EXTENDED, 0x100 | REMOTE)),
    *(to_bytes(FEEDBACK._replace(flags=FD | flag)) for flag in (0, ESI)),
    to_bytes(COMMAND),
    TOO_LONG,
    to_bytes(Frame(0x701, b"\x05")),
    to_bytes(Frame(ERROR | 0x004, bytes.fromhex("0001000000070000"))),
    b"handshake",
]
OF_CLASSIC_CAN = [
    *(to_bytes(Frame(0x100 + axis, bytes(range(8)))) for axis in range(4)),
    *(to_bytes(Frame(0x100 | kind, bytes(range(8)))) for kind in (EXTENDED, REMOTE)),
    to_bytes(Frame(0x701, b"\x05")),
    *(to_bytes(Frame(ERROR | kind, bytes.fromhex("0001000000070000"))) for kind in (0x004, 0x040, 0x100)),
    to_bytes(Frame(0x100, bytes(8)))[:4] + bytes((9,)) + bytes(11),  # longer than any frame
    b"handshake",
]


@pytest.fixture
def cable() -> Iterator[Cable]:
    cable = Cable.pair()
    yield cable
    cable.close()


@pytest.fixture
def port(cable: Cable) -> Port:
    return Port(lambda: cable, fd=True, receive_limit=32)


def drain(port: Port) -> list[Frame]:
    return port.drain(time.monotonic_ns())


def microsecond(time_ns: int) -> int:
    """The whole microsecond that a time is in: what stamps are cut to."""
    return time_ns // 1000 * 1000


def bare(frames: list[Frame]) -> list[Frame]:
    return [frame._replace(timestamp_ns=0) for frame in frames]


def feed(monkeypatch: pytest.MonkeyPatch, port: Port, packets: list[Any]) -> None:
    """Let the kernel bring these to the port at every read: (result, contents), as a ReceiveBlock gives them."""
    headers, _, _, slots = port._block._parts[len(packets)]

    def bring(*_: object) -> int:
        for number, (result, contents) in enumerate(packets):
            receive_block._RESULT.pack_into(headers, number * HEADER_BYTES, *result)
            receive_block._CONTENTS.pack_into(slots, number * (CANFD_MTU + CONTROL_BYTES), *contents)
        return len(packets)

    monkeypatch.setattr(port._block, "_receive", bring)


def test_a_drain_empties_the_socket_oldest_first(port: Port, cable: Cable) -> None:
    sent = [FEEDBACK._replace(can_id=0x100 + axis) for axis in range(4)] + [Frame(0x701, b"\x05")]
    cable.arrive(*sent)
    assert bare(drain(port)) == sent
    assert drain(port) == []
    assert port.counters() == PortCounters(received=5)


def test_what_is_sent_arrives_as_the_kernels_frame_bytes(port: Port, cable: Cable) -> None:
    assert port.send(COMMAND)
    assert cable.far.recv(100) == to_bytes(COMMAND)
    assert port.counters() == PortCounters(sent=1)


def test_a_stamp_is_the_monotonic_time_of_arrival(port: Port, cable: Cable) -> None:
    times = [time.monotonic_ns()]
    for _ in range(3):
        cable.arrive(FEEDBACK)
        times.append(time.monotonic_ns())
    stamps = [frame.timestamp_ns for frame in drain(port)]
    slack = 100_000  # the two clocks are read one after the other
    assert all(
        before - slack <= stamp <= after + slack for stamp, (before, after) in zip(stamps, pairwise(times), strict=True)
    )
    assert stamps == sorted(stamps)
    assert not any(stamp % 1000 for stamp in stamps)


@given(
    stamp=st.integers(10**18, 10**18 + 2 * 10**9),
    age=st.integers(-(10**6), 2 * 10**9) | st.integers(0, 10**6),
    window=st.integers(0, 2 * 10**9) | st.integers(0, 10**6),
    offset=st.integers(0, 10**9),
)
def test_the_fast_path_never_mistakes_the_second(stamp: int, age: int, window: int, offset: int) -> None:
    block = ReceiveBlock(CANFD_MTU)
    block.expect(len(FEEDBACK.data), FEEDBACK.flags)
    used, plain, _, slots = block._parts[1]
    cmsg = struct.pack("@Niill", 32, socket.SOL_SOCKET, SO_TIMESTAMPNS, *divmod(stamp, 10**9))
    slots[: CANFD_MTU + len(cmsg)] = to_bytes(FEEDBACK) + cmsg
    used[:] = plain
    latest = stamp + age - offset
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(block, "_receive", lambda *_: 1)
        frames = block.frames(0, offset, latest - window, latest)
    if 0 <= age <= window < 10**9 and stamp // 10**9 == (stamp + age) // 10**9:
        assert frames == [FEEDBACK._replace(timestamp_ns=microsecond(stamp - offset))]
    elif frames is not None:
        assert microsecond(latest - window) <= frames[0].timestamp_ns <= latest


@pytest.mark.parametrize("step_s", [-3600, 3600])
def test_setting_the_wall_clock_cannot_move_a_stamp_out_of_its_interval(
    port: Port, cable: Cable, monkeypatch: pytest.MonkeyPatch, step_s: int
) -> None:
    previous = time.monotonic_ns()
    port.drain(previous)
    cable.arrive(FEEDBACK, FEEDBACK)  # stamped before the step
    monkeypatch.setattr(bus_module, "time_ns", lambda: time.time_ns() + step_s * 10**9)
    frames = drain(port)
    assert len(frames) == 2
    assert all(microsecond(previous) <= frame.timestamp_ns <= time.monotonic_ns() for frame in frames)


def test_a_flood_keeps_the_newest_frames_and_counts_the_rest(port: Port, cable: Cable) -> None:
    flood = [Frame(0x200, struct.pack("<I", number)) for number in range(3 * SLOTS + 5)]
    drain(port)
    cable.arrive(*flood)
    assert bare(drain(port)) == flood[-32:]
    assert port.counters() == PortCounters(received=len(flood), discarded=len(flood) - 32)


def test_what_has_gathered_before_the_first_drain_is_no_flood(port: Port, cable: Cable) -> None:
    waiting = [Frame(0x200, struct.pack("<I", number)) for number in range(3 * SLOTS + 5)]
    cable.arrive(*waiting, Frame(ERROR | 0x004, bytes.fromhex("0001000000070000")))
    assert bare(drain(port)) == waiting[-32:]
    counters = port.counters()
    assert (counters.received, counters.discarded, counters.overflow) == (len(waiting), 0, 0)
    cable.arrive(*waiting)
    assert bare(drain(port)) == waiting[-32:]
    assert port.counters().discarded == len(waiting) - 32


def test_a_sender_without_end_costs_a_drain_a_bounded_number_of_reads(
    port: Port, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = (STAMPED, 0, 16)
    contents = (0x200, 1, 0, 0, bytes(64), 35, 0, 0, 0)
    feed(monkeypatch, port, [(result, contents)] * SLOTS)
    assert len(drain(port)) == 32
    assert port.counters().received == 16 * SLOTS


@pytest.mark.requirement(id="SR-6.4")
def test_error_frames_change_the_state_and_the_counters_and_are_not_returned(port: Port, cable: Cable) -> None:
    def after(can_id: int, data: str = "0000000000000000") -> PortCounters:
        cable.arrive(Frame(ERROR | can_id, bytes.fromhex(data)), FEEDBACK)
        assert bare(drain(port)) == [FEEDBACK]
        return port.counters()._replace(received=0)

    assert after(0x020) == PortCounters(errors=1, no_ack=1)
    assert after(0x204, "0020000000008000") == PortCounters(errors=2, no_ack=1, state=BusState.ERROR_PASSIVE)
    assert after(0x088, "0000001900008000") == PortCounters(errors=3, no_ack=2, state=BusState.ERROR_PASSIVE)
    assert after(0x040) == PortCounters(errors=4, no_ack=2, bus_off=1, state=BusState.BUS_OFF)
    assert after(0x100) == PortCounters(errors=5, no_ack=2, bus_off=1, restarted=1)
    assert after(0x004, "0001000000070000") == PortCounters(errors=6, no_ack=2, bus_off=1, restarted=1, overflow=7)


@pytest.mark.requirement(id="SR-6.4")
@pytest.mark.parametrize("number", [errno.ENOBUFS, errno.EAGAIN])
def test_a_full_queue_is_counted_and_the_frame_is_not_tried_again(port: Port, cable: Cable, number: int) -> None:
    cable.next_error = number
    assert not port.send(COMMAND)
    cable.next_error = 0
    assert port.send(FEEDBACK)
    assert cable.far.recv(100) == to_bytes(FEEDBACK)
    assert port.counters() == PortCounters(sent=1, refused=1)


@pytest.mark.parametrize("number", [errno.ENETDOWN, errno.ENODEV, errno.ENXIO])
def test_an_interface_that_is_gone_is_reported_and_bound_again_off_the_loop(number: int) -> None:
    cables = [Cable.pair(), Cable.pair()]
    handed_out = iter(cables)
    port = Port(lambda: next(handed_out), fd=True, receive_limit=32)
    cables[0].next_error = number
    assert not port.send(COMMAND)
    assert port.counters() == PortCounters(down=1, state=BusState.DOWN)
    assert port.rebind()
    assert port.fileno() == cables[1].fileno()
    assert cables[0].near.fileno() == -1
    assert port.send(COMMAND)
    cables[1].arrive(FEEDBACK)
    assert bare(drain(port)) == [FEEDBACK]
    assert port.counters() == PortCounters(down=1, sent=1, received=1)
    port.close()


def test_a_rebind_that_fails_leaves_the_port_down_and_usable_for_the_next_try(cable: Cable) -> None:
    opened = 0

    def open_medium() -> Cable:
        nonlocal opened
        opened += 1
        if opened == 2:
            raise OSError(errno.ENODEV, "No such device")
        return cable

    port = Port(open_medium, fd=True, receive_limit=32)
    assert not port.rebind()
    assert port.counters().state is BusState.DOWN
    assert drain(port) == []


def test_a_bus_that_comes_back_without_its_controller_is_not_called_usable(cable: Cable) -> None:
    spare = Cable.pair()
    spare.present = BusState.BUS_OFF
    media = iter([cable, spare])
    port = Port(lambda: next(media), fd=True, receive_limit=32)
    assert not port.rebind()
    assert port.counters().state is BusState.BUS_OFF
    port.close()


def test_going_down_shows_in_a_read_as_well(port: Port, cable: Cable, monkeypatch: pytest.MonkeyPatch) -> None:
    def read(*_: int) -> None:
        raise OSError(errno.ENETDOWN, "Network is down")

    monkeypatch.setattr(port._block, "_receive", read)
    assert drain(port) == []
    assert port.counters() == PortCounters(down=1, state=BusState.DOWN)


def test_an_own_echo_is_told_apart(port: Port, monkeypatch: pytest.MonkeyPatch) -> None:
    def packet(can_id: int, message_flags: int) -> tuple[tuple[int, ...], tuple[object, ...]]:
        return (STAMPED, message_flags, 16), (can_id, 1, 0, 0, bytes(64), 35, 0, 0, 0)

    packets = [packet(0x080, int(socket.MSG_CONFIRM)), packet(0x100, int(socket.MSG_DONTROUTE)), packet(0x101, 0)]
    feed(monkeypatch, port, packets)
    assert [frame.can_id for frame in drain(port)] == [0x100, 0x101]
    assert port.counters() == PortCounters(received=2, echo=1)


def test_the_echo_that_was_asked_for_is_given_back_with_the_instant_it_was_out(
    cable: Cable, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a raw CAN socket with CAN_RAW_RECV_OWN_MSGS delivers it: the frame again, and MSG_CONFIRM."""
    port = Port(lambda: cable, fd=False, receive_limit=32, echo_id=0x080)
    feed(monkeypatch, port, [((STAMPED, int(flag), 16), (can_id, 1, 0, 0, bytes(64), 35, 0, 0, 0)) for can_id, flag in (
        (0x201, socket.MSG_CONFIRM), (0x080, socket.MSG_CONFIRM), (0x080, socket.MSG_DONTROUTE),
    )])  # fmt: skip
    assert [(frame.can_id, frame.flags) for frame in drain(port)] == [(0x080, ECHO), (0x080, 0)]
    assert port.counters().echo == 2


def test_where_the_medium_gives_none_back_the_sender_stamps_the_echo(cable: Cable) -> None:
    port = EchoingPort(lambda: cable, fd=True, receive_limit=4, echo_id=0x080)
    cable.arrive(FEEDBACK)
    before = time.monotonic_ns()
    assert port.send(COMMAND)
    after = time.monotonic_ns()
    assert port.send(COMMAND._replace(can_id=0x081))
    cable.arrive(FEEDBACK)
    early, echo, late = drain(port)
    assert echo == COMMAND._replace(flags=COMMAND.flags | ECHO, timestamp_ns=echo.timestamp_ns)
    assert early.timestamp_ns <= before
    assert microsecond(before) <= echo.timestamp_ns <= after
    assert echo.timestamp_ns <= late.timestamp_ns
    assert port.counters() == PortCounters(received=2, sent=2, echo=1)
    cable.next_error = errno.ENOBUFS
    assert not port.send(COMMAND)
    assert drain(port) == []
    cable.next_error = 0
    port.send(COMMAND)
    cable.arrive(*[FEEDBACK] * 6)
    assert bare(drain(port)) == [FEEDBACK] * 4  # a flood leaves no room


@pytest.mark.parametrize("flags", [0x80, 0xFF])
def test_nobody_else_can_send_an_echo(port: Port, cable: Cable, flags: int) -> None:
    for _ in range(2):  # the slow path, and then the fast one
        cable.arrive(FEEDBACK._replace(flags=FD | flags))
        (frame,) = drain(port)
        assert not frame.flags & ECHO


def test_frames_that_the_kernel_dropped_are_counted_from_its_own_count() -> None:
    """SO_RXQ_OVFL on a UDP socket on the loopback: the same socket option, cmsg and code path as on a CAN socket."""
    near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    near.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    near.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
    near.bind(("127.0.0.1", 0))
    far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    far.connect(near.getsockname())
    cable = Cable(near, far)
    port = Port(lambda: cable, fd=True, receive_limit=32)
    for _ in range(2):
        before = port.counters()
        cable.arrive(*[FEEDBACK] * 50)
        received = len(drain(port))
        assert 0 < received < 50
        cable.arrive(FEEDBACK)  # the count comes with the next frame that fits
        received += len(drain(port))
        counters = port.counters()
        assert counters.received - before.received == received
        assert counters.overflow - before.overflow == 51 - received
    port.close()


def test_the_kernels_drop_count_may_wrap(port: Port) -> None:
    drain(port)
    port._dropped = 0xFFFFFFFE
    port._note_dropped(3)
    assert port.counters().overflow == 5


def test_a_classic_port_takes_fd_frames_for_errors_as_a_classic_controller_does(cable: Cable) -> None:
    port = Port(lambda: cable, fd=False, receive_limit=32)
    cable.arrive(FEEDBACK, Frame(0x100, b"12345678"))
    assert bare(drain(port)) == [Frame(0x100, b"12345678")]
    assert port.counters() == PortCounters(received=1, errors=1)


def test_packets_of_the_mediums_own_are_handed_to_it(port: Port, cable: Cable) -> None:
    cable.far.send(b"handshake")
    cable.arrive(FEEDBACK)
    cable.far.send(bytes(16)[:-1])
    cable.far.send(TOO_LONG)
    assert bare(drain(port)) == [FEEDBACK]
    assert cable.unknown == [b"handshake", bytes(15), TOO_LONG]
    assert port.counters() == PortCounters(received=1, errors=2)


def test_what_was_sent_before_the_other_end_closed_is_still_received(port: Port, cable: Cable) -> None:
    assert port.send(COMMAND)  # never read: the kernel reports ECONNRESET first
    cable.arrive(FEEDBACK)
    cable.far.close()
    assert bare(drain(port)) == [FEEDBACK]
    assert cable.closed


@given(st.lists(st.binary(min_size=1, max_size=72), max_size=40))
def test_no_packet_raises_and_each_is_accounted_for(packets: list[bytes]) -> None:
    cable = Cable.pair()
    port = Port(lambda: cable, fd=True, receive_limit=1000)
    for packet in packets:
        cable.far.send(packet)
    frames = drain(port)
    counters = port.counters()
    assert counters.received == len(frames)
    assert counters.received + counters.errors == len(packets)
    assert all(len(frame.data) <= (64 if frame.flags & FD else 8) for frame in frames)
    port.close()


@pytest.mark.parametrize(("fd", "packets"), [(True, ORDINARY_AND_NOT), (False, OF_CLASSIC_CAN)])
@given(data=st.data())
def test_the_fast_path_tells_the_same_as_the_slow_one(fd: bool, packets: list[bytes], data: st.DataObject) -> None:
    ticks = data.draw(st.lists(st.lists(st.sampled_from(packets), max_size=6), max_size=6))
    short, long = Cable.pair(), Cable.pair()
    ports = [Port(lambda cable=cable: cable, fd=fd, receive_limit=4) for cable in (short, long)]
    block = ports[1]._block  # to which no message is as plain as it expects
    block._parts = [(used, b"", fresh, slots) for used, _, fresh, slots in block._parts]
    for tick in ticks:
        for cable in (short, long):
            for packet in tick:
                cable.far.send(packet)
        assert bare(drain(ports[0])) == bare(drain(ports[1]))
        assert ports[0].counters() == ports[1].counters()
    assert short.unknown == long.unknown
    for port in ports:
        port.close()
