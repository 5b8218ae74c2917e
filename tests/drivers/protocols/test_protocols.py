"""Frame layouts: the compiled codecs say what the contracts say, damage is refused, a wrong binding is explained."""

import math
import struct
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace
from typing import Any

import cantools
import pytest
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import given
from hypothesis import strategies as st

from drivers import protocols
from drivers.bus_load.schedulability import analyse
from drivers.config import BusConfig
from drivers.frame import BRS, ERROR, EXTENDED, FD, FD_LENGTHS, REMOTE, Frame
from drivers.protocols import LayoutError, device_protocol, host_protocol
from drivers.protocols.base import MOST_SENT, Command, Reject, Sample
from drivers.protocols.base import Message as Announced
from drivers.protocols.checksum import AUTOSAR_POLYNOMIAL, SAE_J1850_POLYNOMIAL, crc8, crc8_table
from drivers.protocols.dbc_codec import compile_codec, load_dbc
from hil.cycle.record import MAX_SENT
from tests.support.paths import RIGS, ROOT

FILES = sorted([*(ROOT / "drivers" / "protocols").glob("*.dbc"), *RIGS.glob("*.dbc")])
STAGES = ("stage_fd", "stage_classic")
RATED = [5.3, 20.0, 0.04, 1.0]

AXES = st.integers(0, 3)
FRACTIONS = st.lists(st.floats(-1, 1), min_size=4, max_size=4)
SAMPLES = st.builds(
    Sample, AXES, st.integers(-(2**31), 2**31 - 1), st.integers(0, 127), st.integers(0, 31), st.integers(0, 2**53)
)


def ends(protocol: str, n_axes: int = 4) -> tuple[Any, Any]:
    bus = BusConfig(protocol=protocol)
    return host_protocol(bus, n_axes, RATED[:n_axes], ROOT), device_protocol(bus, n_axes, RATED[:n_axes], ROOT)


# what a layout says of itself -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("protocol", STAGES)
def test_a_stage_layout_carries_positions_of_32_bits_on_every_axis(protocol: str) -> None:
    for n_axes in (1, 4):
        host, _ = ends(protocol, n_axes)
        assert host.positions == [(-(2**31), 2**31 - 1)] * n_axes


def test_a_force_arrives_within_the_resolution_that_is_stated_and_no_finer() -> None:
    host, device = ends("stage_classic")
    worst = 0.0
    for part in range(-1000, 1001):
        force = [rated * part / 1000.0 for rated in RATED]
        command = device.decode_command(host.encode(Command(0, force, 0b1111, False))[0])
        errors = [abs(a - b) / r for a, b, r in zip(command.force, force, RATED, strict=True)]
        worst = max(worst, *errors)
    assert 0.9 * device.force_resolution < worst <= device.force_resolution * (1.0 + 1e-9)


@pytest.mark.parametrize("protocol", STAGES)
def test_what_is_not_the_command_is_unknown_to_a_device_whatever_its_identifier(protocol: str) -> None:
    _, device = ends(protocol)
    known = BusConfig(protocol=protocol).host_id
    for can_id in (0, 1, known + 1, 0x7FF, EXTENDED, EXTENDED | (known + 1)):
        assert device.decode_command(Frame(can_id, bytes(8))) is Reject.UNKNOWN_ID
    assert device.decode_command(Frame(EXTENDED | known, bytes(8))) is Reject.WRONG_FORMAT
    assert device.decode_command(Frame(ERROR, bytes(8))) is Reject.ERROR_FRAME


# the contracts --------------------------------------------------------------------------------------------------------


def all_messages() -> list[Message]:
    """But for pages: of a multiplexed message the layouts make a codec a page (tests/drivers/families/dbc)."""
    found = [message for path in FILES for message in load_dbc(path).messages]
    return [message for message in found if not message.is_multiplexed()]


def raw_value(signal: Signal) -> st.SearchStrategy[Any]:
    if signal.is_float:
        return st.floats(width=signal.length, allow_nan=False)  # type: ignore[arg-type]
    low = -(1 << (signal.length - 1)) if signal.is_signed else 0
    return st.integers(low, low + (1 << signal.length) - 1)


def assert_same_as_cantools(message: Message, data: st.DataObject) -> None:
    codec = compile_codec(message)
    values = {signal.name: data.draw(raw_value(signal), label=signal.name) for signal in message.signals}
    payload = codec.pack(*(values[name] for name in codec.names))
    assert payload == message.encode(values, scaling=False, strict=False)
    noise = data.draw(st.binary(min_size=message.length, max_size=message.length))
    expected = message.decode(noise, scaling=False, decode_choices=False)
    assert isinstance(expected, dict)
    for name, value in zip(codec.names, codec.unpack(noise), strict=True):
        assert value == expected[name] or (math.isnan(value) and math.isnan(float(expected[name])))  # type: ignore[arg-type]


@pytest.mark.long
@pytest.mark.parametrize("message", all_messages(), ids=lambda message: message.name)
@given(data=st.data())
def test_the_compiled_codec_of_every_shipped_message_is_cantools_own(message: Message, data: st.DataObject) -> None:
    assert_same_as_cantools(message, data)


@st.composite
def any_message(draw: st.DrawFn) -> Message:
    """A message of 1 to 64 bytes with signals of any width, order and kind, none overlapping."""
    length = draw(st.one_of(st.integers(1, 8), st.sampled_from(FD_LENGTHS)).filter(bool))
    free, signals, big = 0, [], draw(st.sampled_from(["big", "little", "mixed by byte"]))
    while free < 8 * length and len(signals) < 12:
        order = "big_endian" if big == "big" or (big != "little" and draw(st.booleans())) else "little_endian"
        if big == "mixed by byte":
            free = -(-free // 8) * 8
        gap = draw(st.integers(0, max(3, length)))
        width = draw(st.integers(1, 64))
        if big == "mixed by byte":
            gap, width = gap // 8 * 8, draw(st.sampled_from([8, 16, 32, 64]))
        if free + gap + width > 8 * length:
            break
        at = free + gap
        start = at if order == "little_endian" else at // 8 * 8 + 7 - at % 8
        is_float = width in (16, 32, 64) and draw(st.booleans())
        conversion = BaseConversion.factory(is_float=is_float)
        signed = is_float or draw(st.booleans())
        name = f"s{len(signals)}"
        signals.append(
            Signal(name, start, width, byte_order=order, is_signed=signed, conversion=conversion)  # type: ignore[arg-type]
        )
        free = at + width
    if not signals:
        signals.append(Signal("s0", 0, 3, byte_order="little_endian"))
    return Message(0x123, "Any", length, signals, strict=True)


@given(message=any_message(), data=st.data())
def test_so_is_that_of_any_message(message: Message, data: st.DataObject) -> None:
    assert_same_as_cantools(message, data)


def test_a_value_that_does_not_fit_its_signal_is_never_cut_silently() -> None:
    classic = load_dbc(ROOT / "drivers/families/stage/stage_classic.dbc").get_message_by_name("Command")
    with pytest.raises(OverflowError):
        compile_codec(classic).pack(2048, 0, 0, 0, 0, 0, 0, 0)
    fd = load_dbc(ROOT / "drivers/families/stage/stage_fd.dbc").get_message_by_name("Command")
    with pytest.raises((struct.error, OverflowError)):
        compile_codec(fd).pack(0.0, 0.0, 0.0, 0.0, 65536, 0, 0)


def test_a_contract_with_other_fields_than_the_code_expects_is_refused() -> None:
    message = load_dbc(ROOT / "drivers/families/stage/stage_fd.dbc").get_message_by_name("Feedback0")
    with pytest.raises(LayoutError, match="expected position"):
        compile_codec(message, ("position", "velocity"))


def test_the_stage_codecs_write_what_cantools_reads() -> None:
    host, device = ends("stage_fd")
    database = cantools.database.load_file(ROOT / "drivers/families/stage/stage_fd.dbc")
    frame = host.encode(Command(70_000, [1.5, -20.0, 0.0, 0.25], 0b1011, True))[0]
    told = database.decode_message(0x80, frame.data)
    assert (told["force_0"], told["force_1"], told["force_3"]) == (1.5, -20.0, 0.25)
    assert (told["sequence"], told["flags"]) == (70_000 % 65_536, 0b11011)
    answer = device.encode_feedback(Sample(2, -123_456, 0b10001, 7, 2**32 + 5))
    assert database.decode_message(0x102, answer.data)["position"] == -123_456
    assert database.decode_message(0x102, answer.data)["sample_time"] == 5


def test_the_crcs_are_those_of_the_catalogue() -> None:
    assert crc8(b"123456789", crc8_table(AUTOSAR_POLYNOMIAL)) == 0xDF  # CRC-8/AUTOSAR
    assert crc8(b"123456789", crc8_table(SAE_J1850_POLYNOMIAL)) == 0x4B  # CRC-8/SAE-J1850


# there and back -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("protocol", STAGES)
@given(
    fractions=FRACTIONS,
    enable=st.integers(0, 15),
    reset=st.booleans(),
    sequence=st.integers(0, 2**40),
    n=st.integers(1, 4),
)
def test_a_command_arrives_within_the_layouts_quantisation(
    protocol: str, fractions: list[float], enable: int, reset: bool, sequence: int, n: int
) -> None:
    host, device = ends(protocol, n)
    force = [fraction * rated for fraction, rated in zip(fractions, RATED[:n], strict=False)]
    (frame,) = host.encode(Command(sequence, force, enable, reset))
    command = device.decode_command(frame)
    assert isinstance(command, Command)
    assert command.sequence == sequence % host.sequence_modulus
    assert command.enable == enable & ((1 << n) - 1)
    assert command.reset is reset
    for axis, (told, heard, rated) in enumerate(zip(force, command.force, RATED, strict=False)):
        step = rated * 2**-23 if protocol == "stage_fd" else rated / 2047
        if protocol == "stage_fd" or command.enable >> axis & 1:
            assert abs(heard - told) <= 0.5001 * step
        else:
            assert heard == 0.0


@pytest.mark.parametrize("protocol", STAGES)
@given(sample=SAMPLES, delay=st.integers(0, 1_500_000))
def test_a_sample_arrives_whole_and_its_stamp_is_unwrapped(protocol: str, sample: Sample, delay: int) -> None:
    host, device = ends(protocol)
    frame = device.encode_feedback(sample)._replace(timestamp_ns=sample.stamp_ns + delay)
    heard = host.decode(frame)
    assert isinstance(heard, Sample)
    assert replace(heard, stamp_ns=0) == replace(sample, stamp_ns=0)
    assert abs(heard.stamp_ns - sample.stamp_ns) <= (0 if protocol == "stage_fd" else 500)


# damage ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("protocol", STAGES)
def test_no_one_or_two_flipped_bits_and_no_other_identifier_pass(protocol: str) -> None:
    host, device = ends(protocol)
    (command,) = host.encode(Command(5, [1.0, -2.0, 0.0, 0.5], 0b1111, False))
    answer = device.encode_feedback(Sample(1, 1000, 1, 5, 77_000))._replace(timestamp_ns=100_000)
    bits = 8 * len(command.data)
    for flips in [*combinations(range(bits), 1), *combinations(range(bits), 2)]:
        mask = sum(1 << bit for bit in flips)
        damaged = (int.from_bytes(command.data, "little") ^ mask).to_bytes(len(command.data), "little")
        assert device.decode_command(command._replace(data=damaged)) is Reject.BAD_CHECKSUM
    for can_id in (0x100, 0x102, 0x103):
        assert host.decode(answer._replace(can_id=can_id)) is Reject.BAD_CHECKSUM


@given(flips=st.sets(st.integers(0, 63), min_size=3, max_size=3))
def test_nor_do_three_under_the_classic_layout(flips: set[int]) -> None:
    host, device = ends("stage_classic")
    answer = device.encode_feedback(Sample(1, -5, 1, 5, 77_000))
    mask = sum(1 << bit for bit in flips)
    damaged = (int.from_bytes(answer.data, "little") ^ mask).to_bytes(8, "little")
    assert host.decode(answer._replace(data=damaged)) is Reject.BAD_CHECKSUM


@pytest.mark.parametrize("protocol", STAGES)
def test_every_other_frame_is_refused_for_its_reason(protocol: str) -> None:
    host, device = ends(protocol)
    good = device.encode_feedback(Sample(0, 1, 0, 1, 1))
    other_format = good._replace(flags=0 if protocol == "stage_fd" else FD | BRS)
    cases = {
        Reject.UNKNOWN_ID: good._replace(can_id=0x200),
        Reject.OWN_ECHO: good._replace(can_id=0x080),
        Reject.ERROR_FRAME: Frame(ERROR | 0x40, bytes(8)),
        Reject.WRONG_LENGTH: good._replace(data=good.data[:-1]),
    }
    for reason, frame in cases.items():
        assert host.decode(frame) is reason
    for frame in (other_format, good._replace(can_id=0x100 | REMOTE), good._replace(can_id=0x100 | EXTENDED)):
        assert host.decode(frame) is Reject.WRONG_FORMAT


@pytest.mark.parametrize("force", [math.nan, math.inf, -math.inf, 5.31, -5.31])
@pytest.mark.parametrize("protocol", [*STAGES, "cia402"])
def test_a_force_no_drive_may_be_told_is_never_encoded(protocol: str, force: float) -> None:
    host = host_protocol(BusConfig(protocol=protocol), 1, [5.3], ROOT)
    with pytest.raises(ValueError, match="gate"):
        host.encode(Command(0, [force], 1, False))


def forged(values: Sequence[Any]) -> Frame:
    """A stage_fd command with a right checksum, whatever it says."""
    from zlib import crc32

    data = struct.pack("<4f2H", *values)
    return Frame(0x080, data + crc32(data, 0x080).to_bytes(4, "little"), FD | BRS)


@pytest.mark.parametrize(
    "values",
    [
        (math.nan, 0, 0, 0, 1, 1),
        (0, math.inf, 0, 0, 1, 1),
        (5.31, 0, 0, 0, 1, 1),
        (0, 0, 0, 0.001, 1, 1),  # an axis the rig does not have
        (0, 0, 0, 0, 1, 0b1000),  # its enable bit
        (0, 0, 0, 0, 1, 1 << 5),  # a reserved flag
    ],
)
def test_a_drive_refuses_a_whole_command_for_one_impossible_field(values: tuple[float, ...]) -> None:
    _, device = ends("stage_fd", 3)
    assert isinstance(device.decode_command(forged((5.3, -20.0, 0.04, 0, 1, 0b10111))), Command)
    assert device.decode_command(forged(values)) is Reject.INVALID_VALUE


def test_a_status_bit_nobody_knows_makes_the_sample_invalid() -> None:
    from zlib import crc32

    host, device = ends("stage_fd")
    data = bytearray(device.encode_feedback(Sample(0, 1, 1, 1, 1)).data[:12])
    data[9] |= 0x80
    frame = Frame(0x100, bytes(data) + crc32(data, 0x100).to_bytes(4, "little"), FD)
    assert host.decode(frame) is Reject.INVALID_VALUE


def test_identifiers_that_collide_and_forces_without_sense_are_refused_at_once() -> None:
    with pytest.raises(LayoutError, match="host_id"):
        host_protocol(BusConfig(host_id=0x101), 2, [1.0, 1.0], ROOT)
    with pytest.raises(LayoutError, match="rated"):
        host_protocol(BusConfig(), 2, [1.0, 0.0], ROOT)
    with pytest.raises(LayoutError, match="5 axes"):
        host_protocol(BusConfig(), 5, [1.0] * 5, ROOT)


class Talkative:
    """A host's side that announces so many frames to its drives, and their answers."""

    def __init__(self, frames: int) -> None:
        self.frames = frames

    def messages(self, period_ns: int) -> list[Announced]:
        return [
            Announced(f"{sender} {number}", number, 8, False, period_ns, period_ns, 0, sender)
            for sender in ("host", "axis 0")
            for number in range(self.frames)
        ]


def test_more_frames_in_a_tick_than_a_record_keeps_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    wordy = SimpleNamespace(host=lambda: Talkative(frames))
    monkeypatch.setattr(protocols, "_layout", lambda *_: wordy)
    frames = MOST_SENT
    assert isinstance(host_protocol(BusConfig(), 4, RATED, ROOT), Talkative)
    frames = MOST_SENT + 1
    with pytest.raises(
        LayoutError, match=f"up to {MOST_SENT + 1} frames .* in one tick; there is room for {MOST_SENT}"
    ):
        host_protocol(BusConfig(), 4, RATED, ROOT)
    assert MAX_SENT == MOST_SENT


# on the wire ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("protocol", "tick_us"), [("stage_fd", 380), ("stage_classic", 675), ("cia402", 660)])
def test_every_layout_fits_its_tick_as_designed(protocol: str, tick_us: int) -> None:
    messages = host_protocol(BusConfig(protocol=protocol), 4, RATED, ROOT).messages(1_000_000)
    analysis = analyse(messages, 1_000_000, 5_000_000)
    assert analysis.schedulable
    assert analysis.tick_ns == tick_us * 1000


@pytest.mark.parametrize("protocol", [*STAGES, "cia402"])
def test_the_messages_announced_are_the_frames_sent(protocol: str) -> None:
    host, device = ends(protocol)
    announced = {message.can_id: message for message in host.messages(1_000_000)}
    frames = host.encode(Command(0, [0.0] * 4, 0, False))
    cyclic = [frame for frame in frames if frame.can_id in announced]
    assert len(cyclic) == (2 if protocol == "cia402" else 1)
    for frame in [*cyclic, *(device.encode_feedback(Sample(axis, 0, 0, 0, 0)) for axis in range(4))]:
        message = announced[frame.can_id]
        assert (message.length, message.fd) == (len(frame.data), bool(frame.flags & FD))
