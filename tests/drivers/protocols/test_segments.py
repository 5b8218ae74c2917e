"""[bus] taken apart by segment: every list by axis is cut where the axes are, and put together it is what it was."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.config import BusConfig
from drivers.families.dbc.segments import PER_AXIS
from drivers.protocols.base import LayoutError
from drivers.protocols.segments import Segment, segments_of

CHANNELS = ("can0", "vcan7", "other", "last")
SIZES = st.lists(st.integers(1, 3), min_size=2, max_size=4)


def split(sizes: Sequence[int], n_axes: int = 0, **bus: Any) -> list[Segment]:
    """The segments of a rig with so many axes on each."""
    tables = [{"channel": channel, "axes": ["axis"] * size} for channel, size in zip(CHANNELS, sizes, strict=False)]
    return segments_of(BusConfig(segments=tables, bitrate=500_000, **bus), n_axes or sum(sizes))  # type: ignore[arg-type]


def starts(sizes: Sequence[int]) -> list[int]:
    return [sum(sizes[:number]) for number in range(len(sizes))]


@settings(max_examples=30)
@given(sizes=SIZES)
def test_every_segment_is_a_bus_of_its_own_with_the_next_axes(sizes: list[int]) -> None:
    found = split(sizes, feedback_id=0x200)
    assert [axis for segment in found for axis in segment.axes] == list(range(sum(sizes)))
    assert [len(segment.axes) for segment in found] == sizes
    assert [segment.bus.channel for segment in found] == list(CHANNELS[: len(sizes)])
    for first, (_, bus) in zip(starts(sizes), found, strict=True):
        assert bus == BusConfig(channel=bus.channel, feedback_id=0x200 + first, bitrate=500_000)


def test_a_bus_that_says_nothing_of_segments_is_one() -> None:
    bus = BusConfig()
    assert segments_of(bus, 3) == [Segment(range(3), bus)]


def test_a_layout_of_ones_own_is_refused() -> None:
    with pytest.raises(LayoutError, match="a layout of your own, which has all axes on one segment"):
        split([1, 1], protocol="./mine.py:Mine")


@pytest.mark.parametrize("n_axes", [2, 4])
def test_axes_on_none_or_too_many_are_refused(n_axes: int) -> None:
    with pytest.raises(LayoutError, match=f"^bus.segments has 3 axes; the rig has {n_axes}$"):
        split([1, 2], n_axes)


@settings(max_examples=30)
@given(sizes=SIZES, own=st.booleans())
def test_moteus_controllers_keep_their_numbers(sizes: list[int], own: bool) -> None:
    count = sum(sizes)
    numbers = list(range(40, 40 + 3 * count, 3)) if own else list(range(1, count + 1))
    table = {"moteus": {"nodes": numbers, "position": "int16"}} if own else {}
    found = split(sizes, protocol="moteus", **table)
    nodes = [bus.moteus.nodes for _, bus in found if bus.moteus]
    assert [len(part) for part in nodes] == sizes
    assert [number for part in nodes for number in part] == numbers
    assert {bus.moteus.position for _, bus in found if bus.moteus} == {"int16" if own else "int32"}


@settings(max_examples=30)
@given(sizes=SIZES, each=st.booleans(), stated=st.booleans())
def test_canopen_drives_keep_node_file_and_rated_torque(sizes: list[int], each: bool, stated: bool) -> None:
    count = sum(sizes)
    nodes = list(range(20, 20 + 2 * count, 2)) if stated else list(range(7, 7 + count))
    files = [f"{axis}.eds" for axis in range(count)] if each else ["all.eds"]
    rated = [1.0 + axis for axis in range(count)] if stated else []
    table = {"eds": files, "nodes": nodes if stated else [], "rated_torque": rated, "rpdo": "own"}
    found = split(sizes, protocol="cia402", node_id=7, cia402=table)
    tables = [bus.cia402 for _, bus in found if bus.cia402]
    assert [number for part in tables for number in part.nodes] == nodes
    assert [value for part in tables for value in part.rated_torque] == rated
    assert [len(part.nodes) for part in tables] == sizes
    if each:
        assert [file for part in tables for file in part.eds] == files
        assert [len(part.eds) for part in tables] == sizes
    else:
        assert [part.eds for part in tables] == [files] * len(sizes)
    assert {part.rpdo for part in tables} == {"own"}


@settings(max_examples=10)
@given(sizes=SIZES)
def test_our_own_canopen_drives_are_numbered_on(sizes: list[int]) -> None:
    found = split(sizes, protocol="cia402", node_id=5)
    assert [bus.node_id for _, bus in found] == [5 + first for first in starts(sizes)]
    assert {bus.cia402 for _, bus in found} == {None}


def place(axis: int, name: str, **more: Any) -> dict[str, Any]:
    """A signal of an axis; all that begins with the same letter is in one message."""
    return {"message": f"{name[0]}{axis}", "signal": name, **more}


def dbc(count: int, **more: Any) -> dict[str, Any]:
    by_axis = {name: [place(axis, name) for axis in range(count)] for name in PER_AXIS if name not in ("start", "stop")}
    frames = {name: [{"message": f"{name}{axis}"} for axis in range(count)] for name in ("start", "stop")}
    return {**by_axis, **frames, **more}


@settings(max_examples=30)
@given(sizes=SIZES)
def test_signals_by_axis_are_on_its_segment_and_what_is_by_message_where_its_message_is(sizes: list[int]) -> None:
    count = sum(sizes)
    by_message = {
        "constant": [place(axis, "torque", value=3) for axis in range(count)] + [place(0, "nobody's", value=1)],
        "on_change": [f"r{axis}.reset" if axis % 2 else f"r{axis}" for axis in range(count)] + ["n0"],
        "periodic": [{"message": f"start{axis}", "period_s": 0.5} for axis in range(count)],
        "remote": [f"p{axis}" for axis in range(count)],
        "command_counter": [place(axis, "torque count") for axis in range(count)],
        "checksum": [place(axis, "position sum") for axis in range(count)],
    }
    whole = BusConfig(protocol="dbc:any.dbc", dbc=dbc(count, **by_message)).dbc  # type: ignore[arg-type]
    found = split(sizes, protocol="dbc:any.dbc", dbc=dbc(count, **by_message))
    parts = [bus.dbc for _, bus in found if bus.dbc]
    assert len(parts) == len(sizes)
    ends = [*starts(sizes), count]
    for part, (first, end) in zip(parts, pairwise(ends), strict=True):
        for name in PER_AXIS:
            assert getattr(part, name) == getattr(whole, name)[first:end]
        for name in by_message:
            everything = getattr(whole, name)
            common = everything[count:]  # of a message with no axis' signals: for every segment
            assert getattr(part, name) == everything[first:end] + common


@pytest.mark.parametrize("name", [name for name in PER_AXIS if name not in ("position", "torque")])
def test_of_a_list_by_axis_there_is_an_entry_for_each_or_none(name: str) -> None:
    full = dbc(3)
    assert [getattr(bus.dbc, name) for _, bus in split([1, 2], protocol="dbc:any.dbc", dbc={**full, name: []})] == [
        [],
        [],
    ]
    for entries in (full[name][:1], full[name] + full[name][:1]):
        with pytest.raises(LayoutError, match=rf"^bus\.dbc\.{name} has {len(entries)} entries; .* per axis, 3, are"):
            split([1, 2], protocol="dbc:any.dbc", dbc={**full, name: entries})


@pytest.mark.parametrize("name", PER_AXIS)
def test_no_message_has_signals_of_axes_on_two_segments(name: str) -> None:
    full = dbc(3)
    within = {**full, name: [full[name][0], full[name][1], full[name][1]]}
    assert len(split([1, 2], protocol="dbc:any.dbc", dbc=within)) == 2
    across = {**full, name: [full[name][0], full[name][0], full[name][2]]}
    shared = full[name][0]["message"]
    with pytest.raises(LayoutError, match=f"message {shared} has signals of axes on can0 and on vcan7"):
        split([1, 2], protocol="dbc:any.dbc", dbc=across)
