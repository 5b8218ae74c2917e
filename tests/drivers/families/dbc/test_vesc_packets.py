"""VESCs' packets over CAN: what an emulated VESC sends in pieces comes whole, or not at all."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.families.dbc.vesc_packets import (
    FILL_RX_BUFFER,
    FILL_RX_BUFFER_LONG,
    LONGEST,
    MOST_FRAMES,
    PROCESS_RX_BUFFER,
    Assembly,
    Packet,
    identifier,
    question,
)
from drivers.frame import EXTENDED, EXTENDED_MASK, FD, Frame
from drivers.protocols.base import Reject
from sim_plant.drives.vesc_configuration import answer, crc16

VESC, ASKER = 7, 200
PACKETS = st.binary(min_size=7, max_size=LONGEST)


def sent(packet: bytes, vesc_id: int = VESC) -> list[Frame]:
    return answer(packet, vesc_id, ASKER)


def command_of(frame: Frame) -> int:
    return (frame.can_id & EXTENDED_MASK) >> 8


def taken(assembly: Assembly, frames: list[Frame]) -> list[Packet | Reject | None]:
    return [assembly.take(command_of(frame), frame) for frame in frames]


def test_a_question_is_one_frame_in_the_name_of_its_asker() -> None:
    assert question(14, VESC, ASKER) == Frame(EXTENDED | 0x807, bytes((200, 0, 14)))


def test_the_checksum_is_that_of_the_catalogue() -> None:
    """CRC-16/XMODEM."""
    assert crc16(b"123456789") == 0x31C3


def test_a_packet_goes_as_the_firmware_cuts_it() -> None:
    packet = bytes(range(256)) + bytes(range(20))
    frames = sent(packet)
    pieces = {command: [f.data for f in frames if command_of(f) == command] for command in MOST_FRAMES}
    assert [data[0] for data in pieces[FILL_RX_BUFFER]] == list(range(0, 256, 7))
    assert [data[:2] for data in pieces[FILL_RX_BUFFER_LONG]] == [b"\x01\x03", b"\x01\x09", b"\x01\x0f"]
    assert pieces[PROCESS_RX_BUFFER] == [bytes((VESC, 1, 1, 20)) + crc16(packet).to_bytes(2, "big")]
    assert {frame.can_id & 0xFF for frame in frames} == {ASKER}


def test_the_longest_packet_has_so_many_frames() -> None:
    frames = sent(bytes(LONGEST))
    assert {c: sum(command_of(f) == c for f in frames) for c in MOST_FRAMES} == MOST_FRAMES


@given(PACKETS)
def test_what_is_sent_comes_whole_with_its_last_frame(packet: bytes) -> None:
    assert taken(Assembly(VESC), sent(packet)) == [None] * (len(sent(packet)) - 1) + [Packet(packet[0], packet[1:])]


@given(PACKETS, st.randoms(use_true_random=False))
def test_with_a_piece_lost_it_does_not_come_and_the_next_one_does(packet: bytes, draw: random.Random) -> None:
    frames = sent(packet)
    del frames[draw.randrange(len(frames) - 1)]
    assembly = Assembly(VESC)
    assert taken(assembly, frames) == [None] * len(frames)
    assert taken(assembly, sent(packet))[-1] == Packet(packet[0], packet[1:])


@given(PACKETS, st.randoms(use_true_random=False))
def test_with_a_byte_changed_it_does_not_come(packet: bytes, draw: random.Random) -> None:
    frames = sent(packet)
    number = draw.randrange(len(frames))
    last = number == len(frames) - 1
    data = bytearray(frames[number].data)
    first = 2 if last else len(data) - 1  # of the end: length and checksum; of a piece: what it carries
    data[draw.randrange(first, len(data))] ^= draw.randrange(1, 256)
    frames[number] = frames[number]._replace(data=bytes(data))
    outcomes = taken(Assembly(VESC), frames)
    assert not any(isinstance(outcome, Packet) for outcome in outcomes)
    assert outcomes[-1] in (Reject.BAD_CHECKSUM, None)


@given(PACKETS, st.randoms(use_true_random=False))
def test_a_frame_that_comes_twice_changes_nothing(packet: bytes, draw: random.Random) -> None:
    frames = sent(packet)
    number = draw.randrange(len(frames))
    outcomes = taken(Assembly(VESC), [*frames[: number + 1], *frames[number:]])
    assert outcomes.count(Packet(packet[0], packet[1:])) == 1
    assert outcomes.count(None) == len(frames)


@given(PACKETS, PACKETS, st.randoms(use_true_random=False))
def test_another_drives_frames_among_its_own_never_make_a_third_packet(
    ours: bytes, theirs: bytes, draw: random.Random
) -> None:
    """A foreign VESC answers in the name of the same asker, which no VESC that is asked rightly does."""
    queues = [sent(ours), sent(theirs, VESC + 1)]
    mixed = []
    while any(queues):
        queue = draw.choice([queue for queue in queues if queue])
        mixed.append(queue.pop(0))
    for outcome in taken(Assembly(VESC), mixed):
        assert not isinstance(outcome, Packet) or outcome == Packet(ours[0], ours[1:])


def test_the_end_of_a_foreign_answer_is_not_its_end() -> None:
    packet = bytes(range(40))
    frames = sent(packet)
    foreign = sent(packet, VESC + 1)[-1]
    outcomes = taken(Assembly(VESC), [*frames[:-1], foreign, frames[-1]])
    assert outcomes[-2:] == [Reject.SERVICE, Packet(packet[0], packet[1:])]


def test_after_the_rest_of_an_earlier_answer_the_next_one_comes_whole() -> None:
    packet = bytes(range(200))
    frames = sent(packet)
    outcomes = taken(Assembly(VESC), [*frames[15:], *frames])
    assert outcomes == [None] * (len(outcomes) - 1) + [Packet(packet[0], packet[1:])]


def test_a_packet_that_is_too_long_does_not_come() -> None:
    assert set(taken(Assembly(VESC), sent(bytes(LONGEST + 1)))) == {None}


@pytest.mark.parametrize(("data", "flags", "why"), [
    (b"", 0, Reject.WRONG_LENGTH), (b"\0", 0, Reject.WRONG_LENGTH), (b"\0\1", FD, Reject.WRONG_FORMAT),
])  # fmt: skip
def test_frames_of_another_form_are_told(data: bytes, flags: int, why: Reject) -> None:
    for command in MOST_FRAMES:
        assert Assembly(VESC).take(command, Frame(identifier(command, ASKER), data, flags)) is why


@settings(max_examples=300)
@given(st.lists(st.tuples(st.sampled_from(sorted(MOST_FRAMES)), st.binary(max_size=8)), max_size=60))
def test_any_bytes_raise_nothing(frames: list[tuple[int, bytes]]) -> None:
    assembly = Assembly(VESC)
    for command, data in frames:
        outcome = assembly.take(command, Frame(identifier(command, ASKER), data))
        assert outcome is None or isinstance(outcome, Reject | Packet)
