"""The frame of a sensor, by its table of bytes and against the emulated sensor, which is written apart."""

import struct
import zlib
from random import Random

import pytest

from drivers.frame import BRS, FD, Frame
from drivers.protocols.base import Message, Reject
from drivers.sensors.base import Measured, trigger_of
from drivers.sensors.hil_frame import HilSensorFrame

CAN_ID = 0x321


def bytes_of(counts: int, stamp_us: int, sequence: int, status: int, *, fd: bool) -> bytes:
    data = struct.pack("<i", counts) + struct.pack("<H", stamp_us) + bytes((sequence, status))
    return data + struct.pack("<I", zlib.crc32(data, CAN_ID)) if fd else data


@pytest.mark.parametrize("fd", [False, True])
@pytest.mark.parametrize("counts", [0, 1, -1, 2**31 - 1, -(2**31)])
def test_a_frame_says_value_stamp_sequence_and_validity(counts: int, fd: bool) -> None:
    host = HilSensorFrame(CAN_ID, fd=fd, scale=0.25)
    received = 10_000_000_000
    for status, valid in ((0, True), (1, False), (255, False)):
        stamp_us = (received // 1000 - 150) % 65_536
        frame = Frame(CAN_ID, bytes_of(counts, stamp_us, 200, status, fd=fd), FD | BRS if fd else 0, received)
        assert host.decode(frame) == Measured(0.25 * counts, 200, received - 150_000, valid)


def test_a_stamp_is_the_one_nearest_the_reception() -> None:
    host = HilSensorFrame(CAN_ID, fd=False, scale=1.0)
    for received in (0, 65_536_000, 7_777_777_000):
        for stamp_us in (0, 1, 32_767, 32_768, 65_535):
            measured = host.decode(Frame(CAN_ID, bytes_of(0, stamp_us, 0, 0, fd=False), 0, received))
            assert isinstance(measured, Measured)
            assert (measured.stamp_ns - stamp_us * 1000) % 65_536_000 == 0
            assert -32_768_000 <= measured.stamp_ns - received < 32_768_000


def test_what_is_no_such_frame_is_refused_by_reason() -> None:
    classic, checked = HilSensorFrame(CAN_ID, fd=False, scale=1.0), HilSensorFrame(CAN_ID, fd=True, scale=1.0)
    data = bytes_of(5, 6, 7, 0, fd=True)
    assert classic.decode(Frame(CAN_ID, data[:8], FD)) is Reject.WRONG_FORMAT
    assert classic.decode(Frame(CAN_ID, data[:7])) is Reject.WRONG_LENGTH
    assert checked.decode(Frame(CAN_ID, data[:8])) is Reject.WRONG_FORMAT
    assert checked.decode(Frame(CAN_ID, data[:8], FD)) is Reject.WRONG_LENGTH
    for bit in range(8 * len(data)):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        assert checked.decode(Frame(CAN_ID, bytes(damaged), FD)) is Reject.BAD_CHECKSUM
    assert checked.decode(Frame(CAN_ID, data[:8] + zlib.crc32(data[:8], 0x322).to_bytes(4, "little"), FD)) is (
        Reject.BAD_CHECKSUM
    ), "a frame of another identifier"


@pytest.mark.parametrize("fd", [False, True])
def test_whatever_bytes_come_nothing_is_raised(fd: bool) -> None:
    host, rng = HilSensorFrame(CAN_ID, fd=fd, scale=1e-6), Random(1)
    for _ in range(2000):
        frame = Frame(
            CAN_ID, rng.randbytes(rng.choice((0, 1, 7, 8, 12, 64))), rng.choice((0, FD)), rng.randrange(2**60)
        )
        assert isinstance(host.decode(frame), (Measured, Reject))


def message(name: str, can_id: int, period_ns: int, sender: str = "host") -> Message:
    return Message(name, can_id, 8, False, period_ns, period_ns, 0, sender)


def test_a_sensor_samples_at_what_the_drives_sample_at() -> None:
    tick = 1_000_000
    sync, torque, seldom = message("sync", 0x80, tick), message("torque", 0x200, tick), message("state", 0x1, 10**8)
    answer = message("position", 0x300, tick, "x")
    assert trigger_of([torque, sync, answer, seldom], 0x80, tick) == sync
    assert trigger_of([sync, torque, answer, seldom], None, tick) == torque
    assert trigger_of([answer, seldom], None, tick) is None


@pytest.mark.parametrize("fd", [False, True])
def test_what_a_node_of_ours_sends_is_what_the_host_reads(fd: bool) -> None:
    node = HilSensorFrame(CAN_ID, fd=fd, scale=0.25)
    received = 10_000_000_000
    for value, sequence, shown in ((1.5, 7, 1.5), (-2.0, 256 + 9, -2.0), (1e12, 0, 0.25 * (2**31 - 1))):
        frame = node.encode(value, sequence, received - 150_000)
        assert (
            frame.data[:8]
            == bytes_of(round(shown / 0.25), (received // 1000 - 150) % 65_536, sequence % 256, 0, fd=fd)[:8]
        )
        measured = node.decode(frame._replace(timestamp_ns=received))
        assert measured == Measured(shown, sequence % 256, received - 150_000, True)
    unseen = node.decode(node.encode(None, 1, received)._replace(timestamp_ns=received))
    assert isinstance(unseen, Measured)
    assert not unseen.valid
