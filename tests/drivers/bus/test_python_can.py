"""The local bus as a python-can interface."""

import asyncio
import contextlib
import threading
import time
from collections.abc import Iterator

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.bus import local_bus
from drivers.bus.local_bus import LocalBus, from_message, to_message
from drivers.bus.local_medium import LocalMedium
from drivers.frame import BRS, ERROR, ESI, EXTENDED, FD, FD_LENGTHS, REMOTE, Frame
from tests.drivers.bus.conftest import OpenPort
from tests.support.local_member import STOP

PATIENCE_S = 20.0  # only a failing test waits this long
CLOCK_S = 0.01  # by which a clock that is being set right may be off


@pytest.fixture
def buses() -> Iterator[tuple[can.BusABC, can.BusABC]]:
    with (
        can.Bus(interface="local", channel="can0", fd=True) as one,
        can.Bus(interface="local", channel="can0", fd=True) as two,
    ):
        yield one, two


def test_python_can_finds_the_interface_by_its_name(buses: tuple[can.BusABC, can.BusABC]) -> None:
    one, two = buses
    assert isinstance(one, LocalBus)
    assert one.protocol is can.CanProtocol.CAN_FD
    before = time.time()
    one.send(can.Message(arbitration_id=0x123, data=[1, 2, 3], is_extended_id=False))
    message = two.recv(PATIENCE_S)
    assert message is not None
    assert (message.arbitration_id, bytes(message.data), message.is_rx) == (0x123, b"\x01\x02\x03", True)
    assert before - CLOCK_S < message.timestamp < time.time() + CLOCK_S
    assert two.recv(0) is None
    assert {"interface": "local", "channel": "can0"} in can.detect_available_configs("local")


@pytest.mark.parametrize("channel", ["a_channel_of_64_letters".ljust(64, "x"), 7, None])
def test_it_takes_the_channels_that_programs_give_other_interfaces(channel: str | int | None) -> None:
    with (
        can.Bus(interface="local", channel=channel) as one,  # type: ignore[arg-type]
        can.Bus(interface="local", channel="can0" if channel is None else str(channel)) as two,
    ):
        one.send(can.Message(arbitration_id=5, is_extended_id=False))
        message = two.recv(PATIENCE_S)
        assert message is not None
        assert message.arbitration_id == 5


@pytest.mark.parametrize("channel", ["a/b", "..", "", "x" * 65])
def test_a_channel_that_cannot_be_is_refused_as_python_can_refuses(channel: str) -> None:
    with pytest.raises(can.CanInitializationError, match="1 to 64 letters, digits"):
        can.Bus(interface="local", channel=channel)


def test_port_and_python_can_share_a_bus(join: OpenPort, buses: tuple[can.BusABC, can.BusABC]) -> None:
    port = join()
    buses[0].send(can.Message(arbitration_id=5, data=bytes(16), is_fd=True, bitrate_switch=True, is_extended_id=False))
    (frame,) = port.drain(time.monotonic_ns())
    assert frame._replace(timestamp_ns=0) == Frame(5, bytes(16), FD | BRS)
    port.send(Frame(0x18FF0102 | EXTENDED, b"abc"))
    received = buses[0].recv(PATIENCE_S)
    assert received is not None
    assert (received.arbitration_id, received.is_extended_id, received.is_fd) == (0x18FF0102, True, False)


@given(
    st.integers(0, 0x1FFFFFFF),
    st.booleans(),
    st.booleans(),
    st.sampled_from(FD_LENGTHS).flatmap(lambda n: st.binary(min_size=n, max_size=n)),
)
def test_frames_and_python_can_messages_are_the_same_thing(
    identifier: int, extended: bool, brs: bool, data: bytes
) -> None:
    can_id = identifier | EXTENDED if extended else identifier & 0x7FF
    frame = Frame(can_id, data, FD | BRS if brs else FD)
    assert from_message(to_message(frame, 0.0)) == frame
    classic = Frame(can_id | REMOTE, b"")
    assert from_message(to_message(classic, 0.0)) == classic


@given(
    identifier=st.integers(0, 0x1FFFFFFF),
    extended=st.booleans(),
    kind=st.sampled_from([0, REMOTE, ERROR]),
    flags=st.sampled_from([0, FD, FD | BRS, FD | ESI, FD | BRS | ESI]),
    length=st.integers(0, 8),
)
def test_a_message_says_of_a_frame_what_python_can_means_by_it(
    identifier: int, extended: bool, kind: int, flags: int, length: int
) -> None:
    flags = 0 if kind else flags
    wide = extended or kind == ERROR
    can_id = (identifier if wide else identifier & 0x7FF) | (EXTENDED if extended else 0) | kind
    frame = Frame(can_id, bytes(length) if kind == REMOTE else bytes(range(length)), flags, 5)
    message = to_message(frame, 1.5, "can7", is_rx=False)
    assert (message.timestamp, message.channel, message.is_rx) == (1.5, "can7", False)
    assert message.arbitration_id == (identifier if wide else identifier & 0x7FF)
    assert (message.is_extended_id, message.is_remote_frame, message.is_error_frame) == (
        extended, kind == REMOTE, kind == ERROR,
    )  # fmt: skip
    assert (message.is_fd, message.bitrate_switch, message.error_state_indicator) == (
        flags & FD != 0, flags & BRS != 0, flags & ESI != 0,
    )  # fmt: skip
    assert (message.dlc, bytes(message.data)) == (length, b"" if kind == REMOTE else bytes(range(length)))
    assert from_message(message) == frame._replace(timestamp_ns=0)


def test_filters_hold(buses: tuple[can.BusABC, can.BusABC]) -> None:
    one, two = buses
    two.set_filters([{"can_id": 0x200, "can_mask": 0x7F0}])
    for can_id in (0x100, 0x201, 0x210, 0x20F):
        one.send(can.Message(arbitration_id=can_id, is_extended_id=False))
    received = [two.recv(PATIENCE_S), two.recv(PATIENCE_S), two.recv(0)]
    assert [message and message.arbitration_id for message in received] == [0x201, 0x20F, None]


def test_a_classic_member_neither_sees_nor_sends_fd_frames(buses: tuple[can.BusABC, can.BusABC]) -> None:
    long = can.Message(arbitration_id=1, data=bytes(12), is_fd=True, is_extended_id=False)
    with can.Bus(interface="local", channel="can0") as classic:
        buses[0].send(long)
        buses[0].send(can.Message(arbitration_id=2, is_extended_id=False))
        message = classic.recv(PATIENCE_S)
        assert message is not None
        assert message.arbitration_id == 2
        with pytest.raises(can.CanOperationError, match="without fd=True"):
            classic.send(long)


def test_own_messages_are_received_when_asked_for() -> None:
    with can.Bus(interface="local", channel="can0", receive_own_messages=True) as bus:
        bus.send(can.Message(arbitration_id=7, is_extended_id=False))
        message = bus.recv(PATIENCE_S)
        assert message is not None
        assert (message.arbitration_id, message.is_rx) == (7, False)


def test_a_full_queue_raises_as_with_socketcan(buses: tuple[can.BusABC, can.BusABC]) -> None:
    message = can.Message(arbitration_id=1, is_extended_id=False)
    for _ in range(local_bus.RECEIVE_QUEUE):
        with contextlib.suppress(can.CanOperationError):
            buses[0].send(message)
    with pytest.raises(can.CanOperationError, match="Transmit buffer full"):
        buses[0].send(message, timeout=0.01)
    assert buses[1].recv(0) is not None
    assert buses[1].recv(0) is not None
    buses[0].send(message)  # takes two places: it is preceded by the notice of what was lost


def test_a_notifier_thread_and_an_asyncio_notifier_get_every_message(
    buses: tuple[can.BusABC, can.BusABC], join: OpenPort
) -> None:
    sent = list(range(50))

    def burst() -> None:
        for number in sent:
            buses[0].send(can.Message(arbitration_id=number, is_extended_id=False), timeout=PATIENCE_S)

    heard: list[int] = []
    complete = threading.Event()

    def listen(message: can.Message) -> None:
        heard.append(message.arbitration_id)
        if len(heard) == len(sent):
            complete.set()

    with can.Notifier(buses[1], [listen], timeout=0.1):
        burst()
        assert complete.wait(PATIENCE_S)
    assert heard == sent

    async def by_event_loop() -> list[int]:
        reader = can.AsyncBufferedReader()
        with can.Notifier(buses[1], [reader], loop=asyncio.get_running_loop()):
            burst()
            return [(await asyncio.wait_for(reader.get_message(), PATIENCE_S)).arbitration_id for _ in sent]

    assert asyncio.run(by_event_loop()) == sent


def send_all(bus: can.BusABC, total: int, done: threading.Event) -> None:
    for number in range(total):
        bus.send(can.Message(arbitration_id=number, is_extended_id=False), timeout=PATIENCE_S)
    while not done.is_set():  # a loss is told along with a later frame
        with contextlib.suppress(can.CanOperationError):
            bus.send(can.Message(arbitration_id=STOP, is_extended_id=False))


def receive_all(bus: can.BusABC, total: int, heard: list[int]) -> None:
    lost = 0
    while len(heard) + lost < total:
        message = bus.recv(PATIENCE_S)
        assert message is not None
        if message.is_error_frame:
            lost += message.data[5]
        elif message.arbitration_id != STOP:
            heard.append(message.arbitration_id)


@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_threads_may_send_and_receive_at_once_while_members_come_and_go() -> None:
    total = 1500
    done = threading.Event()

    def come_and_go() -> None:
        while not done.is_set():
            LocalMedium("can0", depth=8).close()

    with (
        can.ThreadSafeBus(interface="local", channel="can0") as one,
        can.ThreadSafeBus(interface="local", channel="can0") as two,
    ):
        heard: list[list[int]] = [[], []]
        receivers = [
            threading.Thread(target=receive_all, args=(bus, total, numbers))
            for bus, numbers in zip((one, two), heard, strict=True)
        ]
        others = [threading.Thread(target=send_all, args=(bus, total, done)) for bus in (one, two)]
        others.append(threading.Thread(target=come_and_go))
        for thread in [*receivers, *others]:
            thread.start()
        for thread in receivers:
            thread.join(PATIENCE_S)
        done.set()
        for thread in others:
            thread.join(PATIENCE_S)
        for numbers in heard:
            assert numbers
            assert numbers == sorted(set(numbers))  # none twice, none out of order


def test_a_closed_bus_says_so_and_can_be_closed_again() -> None:
    bus = can.Bus(interface="local", channel="can0")
    bus.shutdown()
    bus.shutdown()
    for use in (bus.recv, bus.fileno, lambda: bus.send(can.Message())):
        with pytest.raises(can.CanOperationError, match="closed bus"):
            use()


def test_a_bus_that_cannot_be_joined_is_an_initialization_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIL_RUNTIME_DIR", "/proc/nowhere")
    with pytest.raises(can.CanInitializationError, match=r"local bus 'can0': runtime directory /proc/nowhere"):
        can.Bus(interface="local", channel="can0")
