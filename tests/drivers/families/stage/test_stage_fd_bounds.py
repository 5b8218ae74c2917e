"""What stage_fd lets through, field by field: at its bound, and just beyond."""

import math
from zlib import crc32

import pytest

from drivers.config import BusConfig
from drivers.families.stage.stage_fd import COMMAND, FEEDBACK, RESET
from drivers.frame import BRS, FD, Frame
from drivers.protocols import device_protocol, host_protocol
from drivers.protocols.base import EVERY_STATUS, Command, Reject, Sample
from tests.support.paths import RIGS

RATED = [1.0, 2.0, 4.0, 0.1]  # 0.1 is none in single precision
BUS = BusConfig()
HOST, DEVICE = host_protocol(BUS, 4, RATED, RIGS), device_protocol(BUS, 4, RATED, RIGS)
FEW = device_protocol(BUS, 2, RATED[:2], RIGS)  # of two axes
(SENT,) = HOST.encode(Command(7, [0.0] * 4, 0, False))


def resealed(layout: object, frame: Frame, *fields: float) -> Frame:
    """The frame with other fields, and the checksum that they have."""
    data = layout.pack(*fields, 0)[:-4]  # type: ignore[attr-defined]
    return frame._replace(data=data + crc32(data, frame.can_id).to_bytes(4, "little"))


@pytest.mark.parametrize("axis", range(4))
def test_each_force_is_held_to_its_own_axis_rated_force(axis: int) -> None:
    force = [0.0] * 4
    for sign in (1.0, -1.0):
        force[axis] = sign * RATED[axis]
        (frame,) = HOST.encode(Command(1, force, 0b1111, False))
        read = DEVICE.decode_command(frame)
        assert isinstance(read, Command)
        assert list(read.force) == pytest.approx(force, rel=1e-6), "also where single precision rounds it up"
    for wrong in (math.nan, math.inf, 1.01 * RATED[axis]):
        force[axis] = wrong
        with pytest.raises(ValueError, match=f"force {wrong} is not within"):
            HOST.encode(Command(1, force, 0b1111, False))
        beyond = resealed(COMMAND, SENT, *force, 7, 0b1111)
        assert DEVICE.decode_command(beyond) is Reject.INVALID_VALUE


def test_an_axis_that_is_not_there_gets_no_force_and_no_enable() -> None:
    host = host_protocol(BUS, 2, RATED[:2], RIGS)
    (frame,) = host.encode(Command(1, [1.0, 2.0], 0b1111, False))
    read = FEW.decode_command(frame)
    assert isinstance(read, Command)
    assert (list(read.force), read.enable) == ([1.0, 2.0], 0b11)
    assert FEW.decode_command(resealed(COMMAND, frame, 0.0, 0.0, 0.05, 0.0, 7, 0)) is Reject.INVALID_VALUE
    for flags in (0b100, 0b1000, RESET << 1, 0x8000):
        assert FEW.decode_command(resealed(COMMAND, frame, 0.0, 0.0, 0.0, 0.0, 7, flags)) is Reject.INVALID_VALUE


@pytest.mark.parametrize(("enable", "reset"), [(0, True), (0, False), (0b1111, True), (0b0101, False)])
def test_a_reset_is_sent_whether_or_not_drives_are_enabled(enable: int, reset: bool) -> None:
    (frame,) = HOST.encode(Command(7, [0.0] * 4, enable, reset))
    assert COMMAND.unpack(frame.data)[5] == enable | (0b10000 if reset else 0)
    read = DEVICE.decode_command(frame)
    assert isinstance(read, Command)
    assert (read.enable, read.reset) == (enable, reset)


@pytest.mark.parametrize("sequence", [0, 0x7FFF, 0x8000, 0xFFFF, 0x10000, 0x18001])
def test_a_sequence_number_has_16_bits(sequence: int) -> None:
    (frame,) = HOST.encode(Command(sequence, [0.0] * 4, 0, False))
    read = DEVICE.decode_command(frame)
    assert isinstance(read, Command)
    assert read.sequence == sequence % 0x10000


@pytest.mark.parametrize("counts", [0, (1 << 31) - 1, -(1 << 31), 1 << 31, -(1 << 31) - 1, 5 << 31])
@pytest.mark.parametrize("stamp_ns", [0, (1 << 31) + 5, (1 << 32) - 1, (1 << 40) + (1 << 31) + 7])
def test_position_and_stamp_wrap_at_32_bits(counts: int, stamp_ns: int) -> None:
    frame = DEVICE.encode_feedback(Sample(1, counts, 0, 3, stamp_ns))
    for late_ns in (-200_000, 0, 300_000):
        sample = HOST.decode(frame._replace(timestamp_ns=stamp_ns + late_ns))
        assert isinstance(sample, Sample)
        assert sample.position == (counts + (1 << 31)) % (1 << 32) - (1 << 31)
        assert (sample.stamp_ns, sample.status, sample.sequence) == (stamp_ns, 0, 3)


def test_a_status_that_no_drive_has_is_refused_and_damage_is_told_as_damage() -> None:
    frame = DEVICE.encode_feedback(Sample(0, 5, EVERY_STATUS, 3, 9))
    assert isinstance(HOST.decode(frame), Sample)
    beyond = resealed(FEEDBACK, frame, 5, 9, EVERY_STATUS + 1, 3)
    assert HOST.decode(beyond) is Reject.INVALID_VALUE
    damaged = beyond._replace(data=bytes([beyond.data[0] ^ 1]) + beyond.data[1:])
    assert HOST.decode(damaged) is Reject.BAD_CHECKSUM, "nobody knows what its status was"


def test_a_frame_that_is_longer_shorter_or_classic_is_none() -> None:
    frame = DEVICE.encode_feedback(Sample(0, 5, 0, 3, 9))
    assert HOST.decode(frame._replace(data=frame.data + bytes(4))) is Reject.WRONG_LENGTH
    assert HOST.decode(frame._replace(data=frame.data[:12])) is Reject.WRONG_LENGTH
    assert HOST.decode(frame._replace(flags=frame.flags & ~(FD | BRS))) is Reject.WRONG_FORMAT
    assert DEVICE.decode_command(SENT._replace(flags=0)) is Reject.WRONG_FORMAT
    assert DEVICE.decode_command(SENT._replace(data=SENT.data + bytes(8))) is Reject.WRONG_LENGTH
    assert DEVICE.decode_command(SENT._replace(data=SENT.data[:20])) is Reject.WRONG_LENGTH
    assert DEVICE.decode_command(SENT._replace(data=b"\1" + SENT.data[1:])) is Reject.BAD_CHECKSUM
