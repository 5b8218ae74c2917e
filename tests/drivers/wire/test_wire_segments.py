"""Segments in one virtual time: what happens on any of them happens in the order of its time."""

from drivers.frame import Frame, segment_of
from drivers.wire.faults import FaultKind, WireFault
from drivers.wire.segments import WireSegments, marking
from drivers.wire.wire import Wire

LONG, SHORT = Frame(0x100, bytes(8)), Frame(0x200, b"")


def test_frames_arrive_in_the_order_of_time_whatever_segment_they_are_on() -> None:
    heard: list[Frame] = []
    wires = [Wire(1_000_000), Wire(1_000_000)]
    for number, wire in enumerate(wires):
        wire.attach("host", marking(heard.append, number))
    hosts = [wire.attach("drive", None) for wire in wires]
    for at in (0, 200_000, 400_000):
        hosts[0].send(LONG, at)
        hosts[1].send(SHORT, at)
    WireSegments(wires).advance(1_000_000)
    assert [segment_of(frame) for frame in heard] == [1, 0] * 3
    stamps = [frame.timestamp_ns for frame in heard]
    assert stamps == sorted(stamps)


def test_an_answer_on_one_segment_to_a_frame_of_the_other_begins_when_that_has_ended() -> None:
    """A stage that joins them sees both at the same time: nothing is sent into the past of either."""
    wires = [Wire(1_000_000), Wire(1_000_000)]
    told: list[tuple[int, int]] = []
    answering = wires[1].attach("drive", None)
    wires[0].attach("listener", lambda frame: answering.send(SHORT, frame.timestamp_ns))
    wires[1].attach("host", lambda frame: told.append((frame.can_id, frame.timestamp_ns)))
    sender, other = wires[0].attach("host", None), wires[1].attach("other", None)
    sender.send(LONG, 0)
    other.send(Frame(0x300, bytes(8)), 300_000)
    WireSegments(wires).advance(1_000_000)
    assert [can_id for can_id, _ in told] == [SHORT.can_id, 0x300]
    assert told[0][1] < 300_000


def test_a_fault_of_a_node_is_injected_where_the_node_is_and_others_everywhere() -> None:
    wires = [Wire(1_000_000), Wire(1_000_000)]
    heard: list[Frame] = []
    for number, wire in enumerate(wires):
        wire.attach("host", marking(heard.append, number))
    drives = [wire.attach(f"drive {number}", None) for number, wire in enumerate(wires)]
    both = WireSegments(wires)
    both.inject(WireFault(FaultKind.DROP, from_ns=0, until_ns=100_000, node="drive 1"))
    for drive in drives:
        drive.send(SHORT, 0)
    both.advance(100_000)
    assert [segment_of(frame) for frame in heard] == [0]
    both.inject(WireFault(FaultKind.DROP, from_ns=100_000, until_ns=200_000))
    for drive in drives:
        drive.send(SHORT, 100_000)
    both.advance(300_000)
    assert len(heard) == 1
    assert both.busy_ns == max(wire.busy_ns for wire in wires)
