"""Several segments behind one Port: who is told what, and what of one segment's trouble the rig sees."""

import time
from collections.abc import Iterator
from functools import partial
from types import SimpleNamespace

import pytest

from drivers.bus import segmented_port
from drivers.bus.counters import BusState, PortCounters, of_all
from drivers.bus.port import Port, PortError
from drivers.bus.segmented_port import SegmentedPort, open_segments
from drivers.config import BusConfig
from drivers.frame import BRS, ECHO, ERROR, FD, SEGMENT, Frame, from_bytes, on_segment, segment_of, to_bytes
from tests.support.cable import Cable

COMMAND = Frame(0x080, bytes(range(24)), FD | BRS)
ANSWER = Frame(0x100, bytes(16), FD | BRS)
BUS_OFF = Frame(ERROR | 0x040, bytes(8))
TWO = [{"channel": "one", "axes": ["x"]}, {"channel": "other", "axes": ["y"]}]


@pytest.fixture
def cables() -> Iterator[list[Cable]]:
    cables = [Cable.pair(), Cable.pair()]
    yield cables
    for cable in cables:
        cable.close()


@pytest.fixture
def port(cables: list[Cable]) -> SegmentedPort:
    return SegmentedPort([Port(lambda cable=cable: cable, fd=True, receive_limit=32) for cable in cables], 8)


def drain(port: Port) -> list[Frame]:
    return port.drain(time.monotonic_ns())


def test_a_frame_goes_out_on_its_segment_alone_and_says_nothing_of_it(port: SegmentedPort, cables: list[Cable]) -> None:
    assert port.send(on_segment(COMMAND, 1))
    assert cables[1].far.recv(100) == to_bytes(COMMAND)
    cables[0].far.setblocking(False)
    with pytest.raises(BlockingIOError):
        cables[0].far.recv(100)
    with pytest.raises(ValueError, match="segment 2: there are 2"):
        port.send(on_segment(COMMAND, 2))


def test_what_comes_says_where_it_came_by_time(port: SegmentedPort, cables: list[Cable]) -> None:
    cables[1].far.send(to_bytes(ANSWER))
    cables[0].far.send(to_bytes(ANSWER._replace(can_id=0x101)))
    frames = drain(port)
    assert [(frame.can_id, segment_of(frame)) for frame in frames] == [(0x100, 1), (0x101, 0)]
    assert frames[0].timestamp_ns <= frames[1].timestamp_ns
    assert port.counters().received == 2


def test_nobody_on_a_bus_can_say_that_his_frame_is_of_another_segment(port: SegmentedPort, cables: list[Cable]) -> None:
    cables[0].far.send(to_bytes(ANSWER._replace(flags=FD | SEGMENT)))
    assert [segment_of(frame) for frame in drain(port)] == [0]


def test_the_receive_limit_is_that_of_all_segments(port: SegmentedPort, cables: list[Cable]) -> None:
    drain(port)
    for number in range(12):
        cables[number % 2].far.send(to_bytes(ANSWER._replace(can_id=number)))
    assert [frame.can_id for frame in drain(port)] == list(range(4, 12))
    assert port.counters().discarded == 4


def test_the_state_is_the_worst_and_only_the_lost_segment_is_rebound(port: SegmentedPort, cables: list[Cable]) -> None:
    cables[1].far.send(to_bytes(BUS_OFF))
    drain(port)
    assert port.counters().state is BusState.BUS_OFF
    assert port.counters().bus_off == 1
    assert [member.counters().state for member in port.members] == [BusState.ERROR_ACTIVE, BusState.BUS_OFF]
    port.members[1].rebind()
    assert port.counters().state is BusState.ERROR_ACTIVE


def test_counters_are_sums() -> None:
    one = PortCounters(*range(11), BusState.ERROR_PASSIVE)
    other = PortCounters(*range(0, 110, 10), BusState.ERROR_ACTIVE)
    assert of_all([one, other]) == PortCounters(*range(0, 121, 11), BusState.ERROR_PASSIVE)


@pytest.mark.replaces_methods
@pytest.mark.parametrize("lost", [(), (0,), (1,), (0, 1)])
@pytest.mark.parametrize("what", ["rebind", "purge"])
def test_all_segments_are_brought_back_whatever_one_of_them_says(what: str, lost: tuple[int, ...]) -> None:
    """Each is asked, and True is said when each says it: a rig with a segment lost has lost its bus."""
    asked: list[int] = []

    def ask(number: int) -> bool:
        asked.append(number)
        return number not in lost

    members = [SimpleNamespace(**{what: partial(ask, number)}) for number in (0, 1)]
    assert getattr(SegmentedPort(members, 8), what)() is (not lost)  # type: ignore[arg-type]
    assert asked == [0, 1]


def test_all_segments_are_left_and_none_can_be_waited_for_alone(port: SegmentedPort, cables: list[Cable]) -> None:
    with pytest.raises(OSError, match="a descriptor for each"):
        port.fileno()
    assert [member.fileno() for member in port.members] == [cable.near.fileno() for cable in cables]
    port.close()
    assert [cable.near.fileno() for cable in cables] == [-1, -1]


def test_a_full_drain_is_no_flood_and_what_gathered_before_the_first_is_none(
    port: SegmentedPort, cables: list[Cable]
) -> None:
    for count, kept, discarded in ((9, 8, 0), (8, 8, 0), (9, 8, 1), (10, 8, 3)):
        for number in range(count):
            cables[number % 2].far.send(to_bytes(ANSWER._replace(can_id=number)))
        assert [frame.can_id for frame in drain(port)] == list(range(count - kept, count))
        assert port.counters().discarded == discarded


@pytest.mark.parametrize("echo_ids", [[None], [None, 0x080]])
def test_the_local_bus_has_as_many_channels(echo_ids: list[int | None]) -> None:
    bus = BusConfig(interface="local", segments=TWO)  # type: ignore[arg-type]
    drives = open_segments(bus, role="device", fd=True)
    host = open_segments(bus, role="host", fd=True, echo_ids=echo_ids)
    for number in (0, 1):
        assert host.send(on_segment(COMMAND, number))
    assert [segment_of(frame) for frame in drain(drives)] == [0, 1]
    assert [(frame.flags & ECHO, segment_of(frame)) for frame in drain(host)] == (
        [(ECHO, 1)] if len(echo_ids) > 1 else []
    )
    host.close()
    drives.close()


def test_of_segments_that_are_not_all_there_none_is_open() -> None:
    bus = BusConfig(interface="socketcan", segments=TWO)  # type: ignore[arg-type]
    with pytest.raises(PortError, match=r"bus\.channel = 'one'"):
        open_segments(bus, role="host", fd=True)


@pytest.mark.replaces_methods
def test_those_that_were_open_are_left_when_one_cannot_be_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, int | None]] = []
    cables = {"one": Cable.pair()}

    def open_port(bus: BusConfig, *, role: str, fd: bool, echo_id: int | None) -> Port:
        asked.append((bus.channel, echo_id))
        if bus.channel not in cables:
            raise PortError(f"no {bus.channel}")
        return Port(lambda: cables[bus.channel], fd=fd, receive_limit=bus.receive_limit)

    monkeypatch.setattr(segmented_port, "open_port", open_port)
    with pytest.raises(PortError, match="no other"):
        open_segments(BusConfig(segments=TWO), role="host", fd=True, echo_ids=[7, 9])  # type: ignore[arg-type]
    assert asked == [("one", 7), ("other", 9)]
    assert cables["one"].near.fileno() == -1


def test_a_rig_on_one_segment_has_its_port_and_its_echoes_alone() -> None:
    port = open_segments(BusConfig(interface="local"), role="host", fd=True, echo_ids=[0x080])
    assert not isinstance(port, SegmentedPort)
    assert port.send(COMMAND)
    assert [frame.flags & ECHO for frame in drain(port)] == [ECHO]
    port.close()


def test_the_segment_is_in_no_byte_on_a_bus_of_classic_frames() -> None:
    frame = on_segment(Frame(0x123, b"ab"), 3)
    assert from_bytes(to_bytes(frame)) == Frame(0x123, b"ab")
    assert (segment_of(frame), on_segment(frame, 0)) == (3, Frame(0x123, b"ab"))
