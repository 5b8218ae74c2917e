"""Every kind of frame written to a trace and read back: whole, or the format says what it loses, and does."""

import math
from pathlib import Path

import can
import pytest
from can.io.logger import Logger
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.bus.local_bus import from_message, to_message
from drivers.frame import BRS, ERROR, ESI, EXTENDED, EXTENDED_MASK, FD, FD_LENGTHS, REMOTE, STANDARD_MASK, Frame
from hil.runs.candump_log import TraceError, frame_text, read_line
from hil.runs.trace_file import read_trace
from hil.runs.traces import LOSSES, WHOLE, open_writer

IDS = st.integers(0, STANDARD_MASK) | st.integers(0, EXTENDED_MASK).map(lambda number: number | EXTENDED)
FLAGS = st.sampled_from([FD, FD | BRS, FD | ESI, FD | BRS | ESI])
FD_DATA = st.sampled_from(FD_LENGTHS).flatmap(lambda length: st.binary(min_size=length, max_size=length))
CLASSIC = st.tuples(IDS, st.binary(max_size=8)).map(lambda parts: Frame(*parts))
ASKING = st.tuples(IDS, st.integers(0, 8)).map(lambda parts: Frame(parts[0] | REMOTE, bytes(parts[1])))
FAST = st.tuples(IDS, FD_DATA, FLAGS).map(lambda parts: Frame(*parts))
ERRORS = st.tuples(st.integers(1, 0x3FF), st.binary(min_size=8, max_size=8)).map(
    lambda parts: Frame(parts[0] | ERROR, parts[1])
)
FRAMES = CLASSIC | ASKING | FAST | ERRORS
START_S = 1_700_000_000.0


def written(frames: list[Frame]) -> list[can.Message]:
    """As received or sent; error frames are nobody's."""
    return [
        to_message(frame, START_S + place * 1e-3, "can0", is_rx=place % 3 != 0 or bool(frame.can_id & ERROR))
        for place, frame in enumerate(frames)
    ]


@pytest.mark.parametrize("name", [f"trace{suffix}" for suffix in WHOLE] + ["trace.log.gz"])
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(frames=st.lists(FRAMES, min_size=1, max_size=20))
def test_a_format_that_is_written_keeps_everything(name: str, tmp_path: Path, frames: list[Frame]) -> None:
    messages = written(frames)
    with open_writer(tmp_path / name) as write:
        for message in messages:
            write(message)
    back = list(read_trace(tmp_path / name))
    assert [from_message(message) for message in back] == frames
    assert [message.is_rx for message in back] == [message.is_rx for message in messages]
    for message, original in zip(back, messages, strict=True):
        assert math.isclose(message.timestamp, original.timestamp, abs_tol=2e-6)


LOST = {  # one frame that shows what each format is refused for
    ".asc": Frame(ERROR | 0x40, bytes(8)),
    ".csv": Frame(0x123, bytes(12), FD | BRS),
    ".db": Frame(0x123, bytes(12), FD | ESI),
    ".trc": Frame(0x123 | REMOTE, bytes(4)),
}


@pytest.mark.parametrize("suffix", [suffix for suffix, loss in LOSSES.items() if loss])
def test_a_format_that_is_refused_loses_something(suffix: str, tmp_path: Path) -> None:
    """Where this fails, python-can has learned to keep it, and the format can be allowed."""
    file = tmp_path / f"trace{suffix}"
    with pytest.raises(TraceError, match="keep everything"):
        open_writer(file)
    with Logger(file) as write:
        write(to_message(LOST[suffix], START_S, 0))
    assert [from_message(message) for message in read_trace(file)] != [LOST[suffix]]


@pytest.mark.parametrize("suffix", [".asc", ".csv", ".db", ".trc"])
def test_what_others_recorded_in_it_is_read(suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"trace{suffix}"
    frames = [Frame(0x123, b"abc"), Frame(0x18DA0102 | EXTENDED, b"")]
    if suffix == ".asc":
        frames += [Frame(0x123, b"", FD | BRS), Frame(0x7FF, bytes(64), FD)]
    with Logger(file) as write:
        for message in written(frames):
            message.channel = 0
            write(message)
    assert [from_message(message) for message in read_trace(file)] == frames


@given(frame=FRAMES)
def test_a_line_of_candump_says_one_frame(frame: Frame) -> None:
    message = read_line(f"(1.5) can0 {frame_text(frame)} R\n")
    assert message is not None
    assert from_message(message) == frame


@given(line=st.text(max_size=60) | st.from_regex(r"\(1\.5\) can0 [0-9A-F]{3,8}##?R?[0-9A-F]{0,40}", fullmatch=True))
def test_no_line_makes_it_fail_in_another_way(line: str) -> None:
    message = read_line(line)
    assert message is None or isinstance(from_message(message), Frame)


def test_lines_of_can_utils_are_read() -> None:
    for line, frame in (
        ("(1436509052.249713) vcan0 044#2A366C2BBA", Frame(0x044, bytes.fromhex("2A366C2BBA"))),
        ("(1436509052.249713) vcan0 12345678#11.22.33", Frame(0x12345678 | EXTENDED, b"\x11\x22\x33")),
        ("(1436509052.249713) vcan0 123##1AABBCC", Frame(0x123, b"\xaa\xbb\xcc", FD | BRS)),
        ("(1436509052.249713) vcan0 123#R", Frame(0x123 | REMOTE, b"")),
        ("(1436509052.249713) vcan0 00000123#R8", Frame(0x123 | REMOTE | EXTENDED, bytes(8))),
        ("(1436509052.249713) vcan0 20000080#0000000000000000", Frame(ERROR | 0x80, bytes(8))),
    ):
        message = read_line(line)
        assert message is not None
        assert from_message(message) == frame


def test_a_line_that_is_none_is_named(tmp_path: Path) -> None:
    file = tmp_path / "trace.log"
    file.write_text("(1.0) can0 123#00\n\n(2.0) can0 123#000\n")
    with pytest.raises(TraceError, match="line 3 is no frame"):
        list(read_trace(file))
