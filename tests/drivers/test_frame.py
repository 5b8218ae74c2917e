"""Frames and the bytes of Linux's can_frame and canfd_frame."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.frame import (
    BRS,
    CAN_MTU,
    CANFD_MTU,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    FD_LENGTHS,
    REMOTE,
    Frame,
    from_bytes,
    sort_by_time,
    to_bytes,
)

IDS = st.one_of(
    st.integers(0, 0x7FF),
    st.integers(0, 0x1FFFFFFF).map(lambda i: i | EXTENDED),
    st.integers(0, 0x7FF).map(lambda i: i | REMOTE),
    st.integers(0, 0x1FFFFFFF).map(lambda i: i | ERROR),
)
CLASSIC = st.builds(Frame, IDS, st.binary(max_size=8), st.just(0), st.just(0))
FLEXIBLE = st.builds(
    Frame,
    IDS,
    st.sampled_from(FD_LENGTHS).flatmap(lambda n: st.binary(min_size=n, max_size=n)),
    st.sampled_from([FD, FD | BRS, FD | ESI, FD | BRS | ESI]),
    st.just(0),
)
FRAMES = st.one_of(CLASSIC, FLEXIBLE)


@given(FRAMES)
def test_a_frame_survives_the_way_to_bytes_and_back(frame: Frame) -> None:
    packet = to_bytes(frame)
    assert len(packet) == (CANFD_MTU if frame.flags & FD else CAN_MTU)
    assert from_bytes(packet) == frame


def test_a_classic_frame_has_the_bytes_of_struct_can_frame() -> None:
    assert to_bytes(Frame(0x123, b"\x01\x02\x03")) == bytes.fromhex("23010000 03000000 0102030000000000")


def test_an_fd_frame_has_the_bytes_of_struct_canfd_frame() -> None:
    packet = to_bytes(Frame(0x18DA0102 | EXTENDED, bytes(range(12)), FD | BRS))
    assert packet == bytes.fromhex("0201da98 0c050000") + bytes(range(12)) + bytes(52)


def packets(size: int) -> st.SearchStrategy[bytes]:
    """Of a frame's size, mostly with a length that fits."""
    length = st.integers(0, size - 8) | st.integers(0, 255)
    return st.builds(lambda data, n: data[:4] + bytes([n]) + data[5:], st.binary(min_size=size, max_size=size), length)


@given(st.binary(max_size=100) | packets(CAN_MTU) | packets(CANFD_MTU))
def test_any_bytes_are_a_possible_frame_or_none(packet: bytes) -> None:
    frame = from_bytes(packet, 7)
    if frame is None:
        assert len(packet) not in (CAN_MTU, CANFD_MTU) or packet[4] not in FD_LENGTHS or packet[4] > len(packet) - 8
    else:
        assert frame.timestamp_ns == 7
        assert frame.data == packet[8 : 8 + packet[4]]


@pytest.mark.parametrize("frame", [Frame(1, bytes(9)), Frame(1, bytes(13), FD), Frame(1, bytes(65), FD)])
def test_a_length_that_no_frame_has_is_refused(frame: Frame) -> None:
    with pytest.raises(ValueError, match=rf"^{len(frame.data)} data bytes"):
        to_bytes(frame)


@given(st.lists(st.integers(-3, 3), max_size=6))
def test_frames_are_sorted_by_time_and_stay_in_order_where_it_is_the_same(times: list[int]) -> None:
    frames = [Frame(number, b"", 0, time) for number, time in enumerate(times)]
    ordered = sorted(frames, key=lambda frame: frame.timestamp_ns)
    sort_by_time(frames)
    assert frames == ordered
