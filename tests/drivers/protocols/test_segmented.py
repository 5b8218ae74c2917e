"""A layout over several segments is that of each of them, for the axes on it: held against those, made by hand."""

from collections.abc import Sequence
from functools import cache
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.config import BusConfig
from drivers.frame import EXTENDED, Frame, on_segment, segment_of
from drivers.protocols import device_protocol, host_protocol
from drivers.protocols.base import Command, LayoutError, Message, Reject, Sample
from drivers.protocols.segmented import SegmentedDevice, SegmentedHost, on_each
from drivers.protocols.segments import Segment
from tests.support.paths import ROOT

RATED = [5.0, 20.0, 0.5, 1.0, 8.0, 0.1, 3.0, 40.0]
CHANNELS = ("can0", "can3", "can2", "can1")
SIZES = st.sampled_from([(1, 1), (2, 1), (1, 3), (3, 2, 1), (1, 1, 1), (2, 1, 3, 1)])
LAYOUTS = st.sampled_from(["stage_fd", "stage_classic"])


def runs(sizes: Sequence[int]) -> list[list[int]]:
    """Numbers of the axes on each segment."""
    axes = list(range(sum(sizes)))
    return [axes[sum(sizes[:n]) : sum(sizes[: n + 1])] for n in range(len(sizes))]


@cache
def bus_of(protocol: str, sizes: tuple[int, ...]) -> BusConfig:
    segments = [
        {"channel": channel, "axes": [f"a{axis}" for axis in axes]}
        for channel, axes in zip(CHANNELS, runs(sizes), strict=False)
    ]
    return BusConfig(protocol=protocol, segments=segments)  # type: ignore[arg-type]


@cache
def host_of(protocol: str, sizes: tuple[int, ...]) -> Any:
    return host_protocol(bus_of(protocol, sizes), sum(sizes), RATED[: sum(sizes)], ROOT)


def drives_of(protocol: str, sizes: tuple[int, ...]) -> Any:
    return device_protocol(bus_of(protocol, sizes), sum(sizes), RATED[: sum(sizes)], ROOT)


@cache
def alone(protocol: str, first: int, count: int) -> tuple[Any, Any]:
    """Host and drives of a rig with these axes and no others."""
    bus = BusConfig(protocol=protocol, feedback_id=0x100 + first)
    rated = RATED[first : first + count]
    return host_protocol(bus, count, rated, ROOT), device_protocol(bus, count, rated, ROOT)


@st.composite
def commands(draw: st.DrawFn, n_axes: int) -> Command:
    fractions = draw(st.lists(st.floats(-1, 1), min_size=n_axes, max_size=n_axes))
    force = [part * rated for part, rated in zip(fractions, RATED, strict=False)]
    return Command(draw(st.integers(0, 1 << 40)), force, draw(st.integers(0, (1 << n_axes) - 1)), draw(st.booleans()))


def told(command: Command, axes: Sequence[int]) -> Command:
    """The part of a command that is for these axes."""
    enable = sum((command.enable >> axis & 1) << place for place, axis in enumerate(axes))
    return Command(command.sequence, [command.force[axis] for axis in axes], enable, command.reset)


@settings(max_examples=40)
@given(protocol=LAYOUTS, sizes=SIZES, data=st.data())
def test_a_command_is_sent_on_every_segment_as_one_for_its_axes(
    protocol: str, sizes: tuple[int, ...], data: st.DataObject
) -> None:
    host = host_of(protocol, sizes)
    command = data.draw(commands(sum(sizes)))
    expected = []
    for number, axes in enumerate(runs(sizes)):
        single, _ = alone(protocol, axes[0], len(axes))
        expected += [on_segment(frame, number) for frame in single.encode(told(command, axes))]
    assert host.encode(command) == expected


@settings(max_examples=40)
@given(sizes=SIZES, data=st.data())
def test_a_layout_is_told_of_its_axes_and_of_no_others(sizes: tuple[int, ...], data: st.DataObject) -> None:
    heard: list[Command] = []

    def encode(command: Command) -> list[Frame]:
        heard.append(command)
        return []

    host = SegmentedHost(parts(*(fake(size, encode=encode) for size in sizes)))
    command = data.draw(commands(sum(sizes)))
    assert host.encode(command) == []
    assert heard == [told(command, axes) for axes in runs(sizes)]
    for count in (0, sum(sizes) - 1, sum(sizes) + 1):
        with pytest.raises(ValueError, match=f"{count} forces for {sum(sizes)} axes"):
            host.encode(command._replace(force=[0.0] * count))


@settings(max_examples=40)
@given(protocol=LAYOUTS, sizes=SIZES, data=st.data())
def test_drives_know_what_their_segment_says_and_of_others_what_it_said_before(
    protocol: str, sizes: tuple[int, ...], data: st.DataObject
) -> None:
    host = host_of(protocol, sizes)
    device, by_part = drives_of(protocol, sizes), drives_of(protocol, sizes)
    n_axes = sum(sizes)
    force, enable = [0.0] * n_axes, [False] * n_axes
    for _ in range(3):
        command = data.draw(commands(n_axes))
        for number, (axes, frame) in enumerate(zip(runs(sizes), host.encode(command), strict=True)):
            single = alone(protocol, axes[0], len(axes))[1].decode_command(on_segment(frame, 0))
            for place, axis in enumerate(axes):
                force[axis], enable[axis] = single.force[place], bool(single.enable >> place & 1)
            bits = sum(1 << axis for axis in range(n_axes) if enable[axis])
            known = Command(single.sequence, force, bits, command.reset)
            assert by_part.decode_part(frame) == known
            last = number == len(sizes) - 1
            assert device.decode_command(frame) == (known if last else Reject.SERVICE)
        assert bits == command.enable


@settings(max_examples=40)
@given(protocol=LAYOUTS, sizes=SIZES, data=st.data())
def test_an_answer_is_of_its_axis_on_its_segment_and_unknown_on_any_other(
    protocol: str, sizes: tuple[int, ...], data: st.DataObject
) -> None:
    host, device = host_of(protocol, sizes), drives_of(protocol, sizes)
    axis = data.draw(st.integers(0, sum(sizes) - 1))
    values = (data.draw(st.integers(-(2**31), 2**31 - 1)), data.draw(st.integers(0, 127)), 5, 123_000)
    (segment,) = [number for number, axes in enumerate(runs(sizes)) if axis in axes]
    frame = device.encode_feedback(Sample(axis, *values))
    assert device.frames_of(Sample(axis, *values)) == [frame]
    assert frame.can_id == 0x100 + axis
    for number in range(4):
        heard = host.decode(on_segment(frame, number))
        if number != segment:
            assert heard is Reject.UNKNOWN_ID
        else:
            single, _ = alone(protocol, runs(sizes)[segment][0], sizes[segment])
            expected = single.decode(on_segment(frame, 0))
            expected.axis += runs(sizes)[segment][0]
            assert (heard, heard.axis, heard.position) == (expected, axis, values[0])
    assert segment_of(frame) == segment


def test_what_is_no_command_or_on_no_segment_is_refused_with_its_reason() -> None:
    host, device = host_of("stage_fd", (1, 2)), drives_of("stage_fd", (1, 2))
    first, last = host.encode(Command(1, [1.0, 2.0, 0.1], 7, False))
    for read in (device.decode_command, device.decode_part):
        assert read(on_segment(first, 2)) is Reject.UNKNOWN_ID
        for segment in (0, 1):
            assert read(on_segment(Frame(0x555, bytes(8)), segment)) is Reject.UNKNOWN_ID
            assert read(on_segment(last._replace(data=last.data[:8]), segment)) is Reject.WRONG_LENGTH
    assert isinstance(device.decode_part(last), Command)
    assert host.decode(on_segment(Frame(EXTENDED | 0x101, bytes(16)), 1)) is Reject.WRONG_FORMAT


@settings(max_examples=40)
@given(protocol=LAYOUTS, sizes=SIZES)
def test_the_traffic_is_that_of_every_segment_under_its_channels_name(protocol: str, sizes: tuple[int, ...]) -> None:
    host = host_of(protocol, sizes)
    expected: list[list[Message]] = []
    for channel, axes in zip(CHANNELS, runs(sizes), strict=False):
        part = []
        for message in alone(protocol, axes[0], len(axes))[0].messages(500_000):
            sender = f"axis {int(message.sender[5:]) + axes[0]}" if message.sender != "host" else "host"
            after = f"{channel} {message.after}" if message.after else message.after
            part.append(message._replace(name=f"{channel} {message.name}", sender=sender, after=after))
        expected.append(part)
    assert host.messages_by_segment(500_000) == expected
    assert host.messages(500_000) == [message for part in expected for message in part]


# what a layout over several segments says of itself -------------------------------------------------------------------


def fake(n_axes: int, **different: Any) -> Any:
    """A layout that says of itself what it is told to."""
    about = {
        "name": "any",
        "n_axes": n_axes,
        "sequence_modulus": 32,
        "checksum": False,
        "states": True,
        "causes": False,
        "resets": True,
        "tells": 0,
        "stamp_wraps_ns": [],
        "fd": False,
        "positions": [(-n_axes, n_axes)] * n_axes,
        "echo_id": None,
        "acts_ns": [],
        "state_ns": 0,
        "problems": [],
        "decode": None,
        "force_resolution": 0.0,
        "enable_lag": 0,
    }
    return SimpleNamespace(**{**about, **different})


def parts(*layouts: Any) -> list[tuple[Segment, Any]]:
    axes = runs([layout.n_axes for layout in layouts])
    return [
        (Segment(range(axes[n][0], axes[n][-1] + 1), BusConfig(channel=CHANNELS[n])), layout)
        for n, layout in enumerate(layouts)
    ]


def test_what_is_told_by_axis_or_segment_is_told_in_their_order_and_of_what_is_one_the_greatest() -> None:
    host = SegmentedHost(
        parts(
            fake(2, echo_id=0x80, acts_ns=[1, 2], state_ns=7, problems=["no answer", "wrong EDS"]),
            fake(1, acts_ns=[3], state_ns=9, fd=True),
            fake(3, echo_id=0x90, acts_ns=[4, 5, 6], state_ns=8, problems=["gone"]),
        )
    )
    assert (host.n_axes, host.fd, host.state_ns, host.echo_id) == (6, True, 9, None)
    assert (host.name, host.sequence_modulus, host.checksum, host.states, host.causes) == (
        "any",
        32,
        False,
        True,
        False,
    )
    assert host.positions == [(-2, 2), (-2, 2), (-1, 1), (-3, 3), (-3, 3), (-3, 3)]
    assert (host.acts_ns, host.echo_ids) == ([1, 2, 3, 4, 5, 6], [0x80, None, 0x90])
    assert host.problems == ["can0: no answer", "can0: wrong EDS", "can2: gone"]
    assert not SegmentedHost(parts(fake(1), fake(1))).fd


@pytest.mark.parametrize("what", ["checksum", "states", "causes", "resets"])
@pytest.mark.parametrize("have", [(True, True), (True, False), (False, True), (False, False)])
def test_what_drives_tell_is_what_those_of_every_segment_tell(what: str, have: tuple[bool, bool]) -> None:
    host = SegmentedHost(parts(*(fake(1, **{what: has}) for has in have)))
    assert getattr(host, what) is all(have)


@pytest.mark.parametrize("moduli", [(32, 0), (0, 32), (32, 32, 16)])
def test_segments_that_number_commands_differently_are_refused(moduli: Sequence[int]) -> None:
    with pytest.raises(LayoutError, match="a sequence number on some and none, or another, on others"):
        SegmentedHost(parts(*(fake(1, sequence_modulus=modulus) for modulus in moduli)))


def test_several_samples_in_a_frame_are_all_of_their_axes() -> None:
    def decode(frame: Frame) -> tuple[Sample, ...]:
        return (Sample(0, 10, 0, 0, 0), Sample(1, 11, 0, 0, 0))

    host = SegmentedHost(parts(fake(3), fake(2, decode=decode)))
    heard = host.decode(on_segment(Frame(1, b""), 1))
    assert isinstance(heard, tuple)
    assert [(sample.axis, sample.position) for sample in heard] == [(3, 10), (4, 11)]


def test_drives_are_as_coarse_and_as_late_as_those_of_the_worst_segment() -> None:
    device = SegmentedDevice(
        parts(fake(1, force_resolution=0.1, enable_lag=2), fake(2, force_resolution=0.3), fake(1, enable_lag=1))
    )
    assert (device.n_axes, device.name, device.fd, device.sequence_modulus) == (4, "any", False, 32)
    assert (device.force_resolution, device.enable_lag) == (0.3, 2)
    assert SegmentedDevice(parts(fake(1), fake(1, fd=True))).fd
    bare: Any = SimpleNamespace(name="bare", n_axes=1)
    device = SegmentedDevice(parts(bare, bare))
    assert (device.fd, device.sequence_modulus, device.force_resolution, device.enable_lag) == (False, 0, 0.0, 0)


def test_of_several_frames_that_with_the_position_is_the_feedback() -> None:
    def frames_of(sample: Sample) -> list[Frame]:
        local = (sample.axis, sample.position, sample.status, sample.sequence, sample.stamp_ns)
        return [Frame(0x200, bytes(local)), Frame(0x100, bytes(local))]

    device = SegmentedDevice(parts(fake(2), fake(2, frames_of=frames_of)))
    sample, data = Sample(3, 4, 5, 6, 7), bytes([1, 4, 5, 6, 7])
    sent = [on_segment(Frame(0x200, data), 1), on_segment(Frame(0x100, data), 1)]
    assert (device.frames_of(sample), device.encode_feedback(sample)) == (sent, sent[1])


def test_the_layout_of_a_segment_that_cannot_be_made_is_named_by_number_and_channel() -> None:
    def make(segment: Segment) -> range:
        if len(segment.axes) > 1:
            raise LayoutError("too many")
        return segment.axes

    with pytest.raises(LayoutError, match=r"^bus\.segments\[1\] \(can3\): too many$"):
        on_each(bus_of("stage_fd", (1, 2, 1)), 4, make)
    made = on_each(bus_of("stage_fd", (1, 1, 1)), 3, make)
    assert [(segment.bus.channel, axes) for segment, axes in made] == [
        ("can0", range(1)), ("can3", range(1, 2)), ("can2", range(2, 3)),
    ]  # fmt: skip
