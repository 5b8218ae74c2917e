"""Error frames as SocketCAN drivers send them, read as fault confinement."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from drivers.bus.counters import BusState
from drivers.bus.error_frames import ErrorReport, decode_error, describe_error, overflow_notice
from drivers.frame import ERROR, Frame

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
    assert notice == Frame(ERROR | 0x004, bytes((0, 0x01, 0, 0, 0, lost, 0, 0)))
    assert decode_error(notice.can_id, notice.data).overflow == lost


@given(st.integers(0, 0xFFFFFFFF), st.binary(max_size=64))
def test_no_error_frame_raises_whatever_its_bytes(can_id: int, data: bytes) -> None:
    report = decode_error(can_id, data)
    assert 0 <= report.overflow <= 255
    assert describe_error(can_id, data)


KERNEL_CLASSES = {  # include/uapi/linux/can/error.h
    0x001: "transmit timeout", 0x002: "arbitration lost", 0x008: "protocol violation", 0x010: "transceiver",
    0x020: "no acknowledgement", 0x040: "bus off", 0x080: "bus error", 0x100: "restarted",
}  # fmt: skip
KERNEL_CONTROLLER = {
    0x01: "receive overflow", 0x02: "transmit overflow", 0x04: "receive warning", 0x08: "transmit warning",
    0x10: "receive passive", 0x20: "transmit passive", 0x40: "error active",
}  # fmt: skip


@given(
    st.integers(0, 0x3FF),
    st.integers(0, 255),
    st.sampled_from([0, 0x18, 0x19, 0x1A]),
    st.lists(st.integers(0, 255), min_size=3, max_size=3),
    st.integers(0, 3),
)
@example(0x008, 0, 0x19, [0, 0, 0], 0)
@example(0x009, 0, 0x19, [0, 0, 0], 0)
def test_every_bit_means_what_the_kernel_says(
    classes: int, controller: int, location: int, rest: list[int], cut: int
) -> None:
    lost, sent, received = rest
    data = bytes((7, controller, 7, location, 7, lost, sent, received))
    says = classes & 0x004 and controller
    if classes & 0x040:
        state: BusState | None = BusState.BUS_OFF
    elif says & 0x30:
        state = BusState.ERROR_PASSIVE
    else:
        state = BusState.ERROR_ACTIVE if says & 0x4C or classes & 0x100 else None
    no_ack = classes & 0x020 != 0 or (classes & 0x008 != 0 and location == 0x19)
    overflow = 0 if not says & 0x01 else lost or 1
    report = ErrorReport(state, no_ack, classes & 0x040 != 0, classes & 0x100 != 0, overflow)
    assert decode_error(ERROR | classes, data) == report
    assert decode_error(ERROR | classes, data + bytes([1] * cut)) == report
    words = [text for bit, text in KERNEL_CLASSES.items() if classes & bit]
    if classes & 0x004:
        words += [text for bit, text in KERNEL_CONTROLLER.items() if controller & bit] or ["controller"]
    if classes & 0x200:
        words.append(f"counters tx {sent} rx {received}")
    assert describe_error(ERROR | classes, data) == (", ".join(words) or "unspecified")


@given(st.integers(0, 0x3FF), st.binary(min_size=8, max_size=8), st.integers(0, 8))
def test_what_is_cut_off_is_zero(classes: int, data: bytes, length: int) -> None:
    short, full = data[:length], data[:length] + bytes(8 - length)
    assert decode_error(ERROR | classes, short) == decode_error(ERROR | classes, full)
    assert describe_error(ERROR | classes, short) == describe_error(ERROR | classes, full)


def test_error_frames_are_put_into_words() -> None:
    assert describe_error(*BUS_OFF) == "bus off, counters tx 248 rx 0"
    assert describe_error(*PASSIVE) == "transmit passive, counters tx 128 rx 0"
    assert describe_error(ERROR, b"") == "unspecified"
