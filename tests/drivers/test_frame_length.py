"""How long a CAN frame is on the wire."""

import random
import shutil
import struct
import subprocess
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.frame import BRS, ESI, EXTENDED, FD, FD_LENGTHS, REMOTE, Frame
from drivers.frame_length import INTERMISSION, frame_bits, worst_case_bits
from tests.support.can_reference import classic_length, fd_length
from tests.support.paths import ROOT

standard_ids = st.integers(0, 0x7FF)
extended_ids = st.integers(0, 0x1FFFFFFF).map(lambda i: i | EXTENDED)
identifiers = standard_ids | extended_ids
# Runs of equal bits are what stuffing is about, so payloads of few distinct bytes are drawn as often as random ones.
runs = st.lists(st.sampled_from([0x00, 0xFF, 0x0F, 0xF0, 0x1F, 0xF8, 0x07, 0x83]), min_size=64, max_size=64).map(bytes)
payloads = st.binary(min_size=64, max_size=64) | runs


@given(identifiers, payloads, st.integers(0, 8))
def test_a_classic_frame_is_as_long_as_its_bits_written_out(can_id: int, data: bytes, length: int) -> None:
    frame = Frame(can_id, data[:length])
    assert frame_bits(frame) == (classic_length(frame), 0)


@given(identifiers, st.integers(0, 8))
def test_a_remote_frame_has_no_data_whatever_length_it_asks_for(can_id: int, length: int) -> None:
    frame = Frame(can_id | REMOTE, bytes(length))
    assert frame_bits(frame) == (classic_length(frame), 0)


@given(identifiers, payloads, st.sampled_from(FD_LENGTHS), st.sampled_from([0, ESI]))
def test_an_fd_frame_is_as_long_as_its_bits_written_out_in_each_phase(
    can_id: int, data: bytes, length: int, esi: int
) -> None:
    frame = Frame(can_id, data[:length], FD | BRS | esi)
    assert frame_bits(frame) == fd_length(frame)


@pytest.mark.parametrize("length", [8, 16, 24, 32])
@pytest.mark.parametrize("can_id", [0x000, 0x080, 0x7FF])
def test_an_fd_frame_with_a_stuff_bit_behind_every_fourth_bit_is_as_long_as_written_out(
    can_id: int, length: int
) -> None:
    # Four equal bits behind a stuff bit bring the next one; one of eight phases falls in with the header.
    runs = "00001111" * (length + 1)
    phases = [int(runs[phase : phase + 8 * length], 2).to_bytes(length, "big") for phase in range(8)]
    longest = max(fd_length(Frame(can_id, payload, FD | BRS))[1] for payload in phases)
    assert longest - worst_case_bits(length, fd=True, extended=False)[1] in (-1, 0)
    for payload in phases:
        frame = Frame(can_id, payload, FD | BRS)
        assert frame_bits(frame) == fd_length(frame)


@pytest.mark.parametrize("length", FD_LENGTHS)
def test_a_frame_of_equal_bits_is_as_long_as_written_out_whatever_its_header_says(length: int) -> None:
    for can_id in (0, 0x7FF, EXTENDED, EXTENDED | 0x1FFFFFFF):
        for payload in (bytes(length), b"\xff" * length):
            for flags in (FD | BRS, FD | BRS | ESI):
                frame = Frame(can_id, payload, flags)
                assert frame_bits(frame) == fd_length(frame)


@given(identifiers, payloads, st.sampled_from(FD_LENGTHS))
def test_without_bit_rate_switch_an_fd_frame_is_nominal_throughout(can_id: int, data: bytes, length: int) -> None:
    frame = Frame(can_id, data[:length], FD)
    assert frame_bits(frame) == (sum(fd_length(frame)), 0)


@given(identifiers, payloads, st.integers(0, 8))
def test_no_classic_frame_exceeds_its_worst_case(can_id: int, data: bytes, length: int) -> None:
    nominal, _ = frame_bits(Frame(can_id, data[:length]))
    worst, _ = worst_case_bits(length, fd=False, extended=bool(can_id & EXTENDED))
    assert nominal + INTERMISSION <= worst


@given(identifiers, payloads, st.sampled_from(FD_LENGTHS), st.sampled_from([1_000_000, 2_000_000, 8_000_000]))
def test_no_fd_frame_lasts_longer_than_its_worst_case(can_id: int, data: bytes, length: int, fast: int) -> None:
    nominal, switched = frame_bits(Frame(can_id, data[:length], FD | BRS))
    worst = worst_case_bits(length, fd=True, extended=bool(can_id & EXTENDED))
    assert (nominal + INTERMISSION) * 8_000_000 // 1_000_000 + switched * 8_000_000 // fast <= (
        worst[0] * 8_000_000 // 1_000_000 + worst[1] * 8_000_000 // fast
    )


def test_a_classic_frame_of_alternating_runs_reaches_the_worst_case() -> None:
    # Four equal bits behind each stuff bit from SOF on: id 0x078 = 000 0111 1000 and matching payload, by search.
    best = max(
        frame_bits(Frame(can_id, bytes([byte] * 8)))[0] + INTERMISSION
        for can_id in (0x000, 0x078, 0x07F, 0x780, 0x3C3)
        for byte in range(256)
    )
    worst = worst_case_bits(8, fd=False, extended=False)[0]
    assert worst == 135
    assert worst - 5 <= best <= worst  # the CRC cannot be chosen freely, nor RTR, IDE and r0


@pytest.mark.parametrize(("length", "bits"), [(0, 55), (1, 65), (4, 95), (6, 115), (8, 135)])
def test_worst_cases_are_those_of_the_paper(length: int, bits: int) -> None:
    assert worst_case_bits(length, fd=False, extended=False) == (bits, 0)
    assert worst_case_bits(length, fd=False, extended=True) == (bits + 25, 0)


def test_an_unknown_payload_length_is_refused() -> None:
    with pytest.raises(ValueError, match="9 bytes"):
        frame_bits(Frame(0x80, bytes(9)))
    with pytest.raises(ValueError, match="9 bytes"):
        frame_bits(Frame(0x80, bytes(9), FD | BRS))
    with pytest.raises(ValueError, match="length = 9"):
        worst_case_bits(9, fd=False, extended=False)
    with pytest.raises(ValueError, match="length = 9"):
        worst_case_bits(9, fd=True, extended=False)


@pytest.fixture(scope="module")
def canbusload(tmp_path_factory: pytest.TempPathFactory) -> Callable[[list[Frame], list[str]], list[int]]:
    """Asks can-utils' own can_frame_length(), through canbusload, for the bits of each frame (with intermission)."""
    compiler, program = shutil.which("cc"), shutil.which("canbusload")
    if program is None or compiler is None:
        pytest.skip("needs canbusload (Debian: can-utils) and a C compiler (Debian: gcc)")
    shim = tmp_path_factory.mktemp("shim") / "canbusload_stdin.so"
    source = ROOT / "tests" / "support" / "canbusload_stdin.c"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", shim, source], check=True)

    def ask(frames: list[Frame], options: list[str]) -> list[int]:
        stream = b"".join(struct.pack("=IB3x8s", f.can_id, len(f.data), f.data) for f in frames)
        done = subprocess.run(
            [program, *options, "can0@1000000"],
            input=stream,
            capture_output=True,
            check=True,
            env={"LD_PRELOAD": str(shim)},
            timeout=60,
        )
        lines = [line.split() for line in done.stdout.decode().splitlines() if line.strip()]
        assert all(line[1] == "1" for line in lines)  # frames in that line
        return [int(line[2]) for line in lines]

    return ask


def test_classic_lengths_agree_with_can_utils_for_every_payload_length(
    canbusload: Callable[[list[Frame], list[str]], list[int]],
) -> None:
    draw = random.Random(11898)
    frames = [
        Frame(can_id, data)
        for length in range(9)
        for can_id in (0, 0x080, 0x7FF, draw.randrange(0x800), EXTENDED, EXTENDED | draw.randrange(1 << 29))
        for data in (bytes(length), b"\xff" * length, b"\x0f\x87" * 4, *(draw.randbytes(length) for _ in range(20)))
        if len(data) == length
    ]
    exact = canbusload(frames, ["-e"])
    assert len(exact) == len(frames) > 1000
    assert exact == [frame_bits(frame)[0] + INTERMISSION for frame in frames]
    worst = canbusload(frames, [])
    assert worst == [
        worst_case_bits(len(frame.data), fd=False, extended=bool(frame.can_id & EXTENDED))[0] for frame in frames
    ]
