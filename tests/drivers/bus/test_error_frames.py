"""Error frames as SocketCAN drivers send them, read as fault confinement."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.bus.counters import BusState
from drivers.bus.error_frames import ErrorReport, decode_error, describe_error, overflow_notice
from drivers.frame import ERROR

# What kernel drivers put into an error frame: sja1000, kvaser, mcp251xfd, m_can, and the core (drivers/net/can/dev).
BERR_NO_ACK_SJA1000 = (ERROR | 0x088, bytes.fromhex("00 00 00 19 00 00 80 00"))
NO_ACK_CORE = (ERROR | 0x020, bytes(8))
PASSIVE = (ERROR | 0x204, bytes.fromhex("00 20 00 00 00 00 80 00"))
WARNING = (ERROR | 0x204, bytes.fromhex("00 08 00 00 00 00 60 00"))
ACTIVE = (ERROR | 0x204, bytes.fromhex("00 40 00 00 00 00 5f 00"))
BUS_OFF = (ERROR | 0x240, bytes.fromhex("00 00 00 00 00 00 f8 00"))
RESTARTED = (ERROR | 0x100, bytes(8))
STUFF_ERROR = (ERROR | 0x088, bytes.fromhex("00 00 04 00 00 00 00 00"))
OVERFLOW = (ERROR | 0x004, bytes.fromhex("00 01 00 00 00 00 00 00"))


@pytest.mark.parametrize(
    ("frame", "report"),
    [
        (BERR_NO_ACK_SJA1000, ErrorReport(None, True, False, False, 0)),
        (NO_ACK_CORE, ErrorReport(None, True, False, False, 0)),
        (PASSIVE, ErrorReport(BusState.ERROR_PASSIVE, False, False, False, 0)),
        (WARNING, ErrorReport(BusState.ERROR_ACTIVE, False, False, False, 0)),
        (ACTIVE, ErrorReport(BusState.ERROR_ACTIVE, False, False, False, 0)),
        (BUS_OFF, ErrorReport(BusState.BUS_OFF, False, True, False, 0)),
        (RESTARTED, ErrorReport(BusState.ERROR_ACTIVE, False, False, True, 0)),
        (STUFF_ERROR, ErrorReport(None, False, False, False, 0)),
        (OVERFLOW, ErrorReport(None, False, False, False, 1)),
    ],
)
def test_what_drivers_report_is_understood(frame: tuple[int, bytes], report: ErrorReport) -> None:
    assert decode_error(*frame) == report


def test_an_acknowledge_slot_outside_a_protocol_error_means_nothing() -> None:
    assert not decode_error(ERROR | 0x004, BERR_NO_ACK_SJA1000[1]).no_ack


def test_bus_off_wins_over_what_else_the_frame_says() -> None:
    assert decode_error(ERROR | 0x044, bytes.fromhex("0010000000000000")).state is BusState.BUS_OFF


@given(st.integers(1, 255))
def test_an_overflow_notice_tells_how_many_frames_were_lost(lost: int) -> None:
    notice = overflow_notice(lost)
    assert decode_error(notice.can_id, notice.data).overflow == lost


@given(st.integers(0, 0xFFFFFFFF), st.binary(max_size=64))
def test_no_error_frame_raises_whatever_its_bytes(can_id: int, data: bytes) -> None:
    report = decode_error(can_id, data)
    assert 0 <= report.overflow <= 255
    assert describe_error(can_id, data)


def test_error_frames_are_put_into_words() -> None:
    assert describe_error(*BUS_OFF) == "bus off, counters tx 248 rx 0"
    assert describe_error(*PASSIVE) == "transmit passive, counters tx 128 rx 0"
    assert describe_error(ERROR, b"") == "unspecified"
