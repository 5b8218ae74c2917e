"""Segments in one virtual time: what happens on any of them happens in the order of its time."""

import pytest

from drivers.frame import Frame, segment_of
from drivers.frame_length import frame_bits
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


def test_a_receiver_sees_the_time_of_what_it_receives_whatever_segment_it_is_on() -> None:
    wires = [Wire(1_000_000) for _ in range(3)]
    both = WireSegments(wires)
    seen: list[tuple[int, int]] = []
    for number, wire in enumerate(wires):
        wire.attach("host", lambda frame: seen.append((both.now_ns, frame.timestamp_ns)))
        wire.attach("drive", None).send(Frame(0x100, bytes(8 - number)), 1_000 * number)
    both.advance(1_000_000)
    assert len(seen) == 3
    assert [now_ns for now_ns, _ in seen] == [stamp_ns for _, stamp_ns in seen]


def test_all_segments_reach_the_time_they_are_told_busy_or_not() -> None:
    wires = [Wire(1_000_000), Wire(1_000_000)]
    wires[1].attach("host", None)
    wires[1].attach("drive", None).send(SHORT, 0)
    both = WireSegments(wires)
    for until_ns in (5_000, 5_000, 1_000_000):
        both.advance(until_ns)
        assert (both.now_ns, *(wire.now_ns for wire in wires)) == (until_ns,) * 3
    assert both.nominal_ns == wires[0].nominal_ns


def test_what_a_frame_that_ends_with_the_advance_brings_about_elsewhere_has_come_about() -> None:
    wires = [Wire(1_000_000), Wire(1_000_000)]
    drive = wires[0].attach("drive", None)
    wires[1].attach("host", lambda frame: wires[0].inject(WireFault(FaultKind.DOWN, frame.timestamp_ns)))
    wires[1].attach("other", None).send(SHORT, 0)
    both = WireSegments(wires)
    end_ns = wires[1].nominal_ns[sum(frame_bits(SHORT))]
    both.advance(end_ns - 1)
    assert drive.interface_up
    both.advance(end_ns)
    assert not drive.interface_up


def test_of_several_segments_the_losses_are_added_and_the_busiest_counts() -> None:
    wires = [Wire(1_000_000, drop_probability=0.999), Wire(1_000_000, drop_probability=0.999)]
    for wire, count in zip(wires, (3, 5), strict=True):
        wire.attach("host", lambda frame: None)
        drive = wire.attach("drive", None)
        for _ in range(count):
            drive.send(SHORT, 0)
    both = WireSegments(wires)
    both.advance(2_000_000)
    assert [wire.dropped for wire in wires] == [3, 5]
    assert both.dropped == 8
    assert both.busy_ns == wires[1].busy_ns > wires[0].busy_ns > 0


def test_nodes_of_all_segments_are_found_by_name_and_a_fault_takes_those_that_are_named() -> None:
    wires = [Wire(1_000_000), Wire(1_000_000)]
    hosts = [wire.attach("host", None) for wire in wires]
    drives = [wire.attach(f"drive {number}", None) for number, wire in enumerate(wires)]
    both = WireSegments(wires)
    assert both.nodes == {"drive 0": drives[0], "drive 1": drives[1], "host": hosts[1]}
    both.inject(WireFault(FaultKind.DOWN, node="drive 1"))
    both.inject(WireFault(FaultKind.BUS_OFF, node="host"))
    both.advance(1)
    assert [drive.interface_up for drive in drives] == [True, False]
    assert [host.is_bus_off for host in hosts] == [True, True]
    both.inject(WireFault(FaultKind.DOWN))
    both.advance(2)
    assert [node.interface_up for node in (*hosts, *drives)] == [False] * 4
    both.inject(WireFault(FaultKind.DOWN, node="drive 2"))
    with pytest.raises(ValueError, match="no node 'drive 2'"):
        both.advance(3)
