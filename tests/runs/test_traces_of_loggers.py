"""Logs of BUSMASTER and of GVRET devices: every frame with its kind and its time, or an error with the line."""

from pathlib import Path

import can
import pytest

from hil.runs.candump_log import TraceError
from hil.runs.trace_file import read_trace

HEAD = "***BUSMASTER Ver 2.4.0***\n***PROTOCOL CAN***\n***{base}***\n***{mode} MODE***\n"
GVRET = "Time Stamp,ID,Extended,{}Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"


def read(folder: Path, name: str, text: str) -> list[can.Message]:
    (folder / name).write_text(text)
    return list(read_trace(folder / name))


def busmaster(folder: Path, lines: str, base: str = "HEX", mode: str = "SYSTEM") -> list[can.Message]:
    return read(folder, "made.log", HEAD.format(base=base, mode=mode) + lines)


def test_every_kind_of_frame_of_busmaster(tmp_path: Path) -> None:
    found = busmaster(
        tmp_path,
        "00:00:01:5000 Rx 1 0x12A s 2 01 FF \n00:00:01:5001 Tx 2 0x18FEF200 x 0\n00:00:02:500 Rx 1 408 sr 8\n"
        f"00:00:02:6000 Rx 1 0x408 xr 2 00 00\n00:00:02:7000 Rx 1 0x7FF s-fd 12{' 11' * 12}\n***[STOP LOGGING]***\n",
    )
    assert [(m.arbitration_id, m.is_extended_id, m.is_remote_frame, m.is_fd, m.dlc) for m in found] == [
        (0x12A, False, False, False, 2),
        (0x18FEF200, True, False, False, 0),
        (0x408, False, True, False, 8),
        (0x408, True, True, False, 2),
        (0x7FF, False, False, True, 12),
    ]
    assert [(bytes(m.data), m.is_rx, m.channel) for m in found[:2]] == [(b"\x01\xff", True, 1), (b"", False, 2)]
    assert [m.timestamp for m in found] == pytest.approx([1.5, 1.5001, 2.5, 2.6, 2.7])


def test_decimal_logs_have_decimal_identifiers_and_bytes(tmp_path: Path) -> None:
    (found,) = busmaster(tmp_path, "14:08:20:4009 Tx 1 0021 s 2 010 255\n", base="DEC")
    assert (found.arbitration_id, bytes(found.data)) == (21, b"\x0a\xff")


@pytest.mark.parametrize(
    ("mode", "times", "seconds"),
    [
        ("SYSTEM", ["23:59:59:9000", "23:59:59:8990", "00:00:00:1000"], [0.0, -0.001, 0.2]),  # past midnight
        ("ABSOLUTE", ["00:00:00:1000", "00:00:00:3000", "01:00:00:0000"], [0.0, 0.2, 3599.9]),
        ("RELATIVE", ["00:00:00:1000", "00:00:00:3000", "00:00:01:0000"], [0.0, 0.3, 1.3]),
    ],
)
def test_times_of_busmaster_are_of_the_day_of_the_log_or_of_the_last_frame(
    mode: str, times: list[str], seconds: list[float], tmp_path: Path
) -> None:
    found = busmaster(tmp_path, "".join(f"{time} Rx 1 0x1 s 0\n" for time in times), mode=mode)
    assert [m.timestamp - found[0].timestamp for m in found] == pytest.approx(seconds, abs=1e-9)


def test_blank_lines_before_a_log_change_neither_its_kind_nor_its_line_numbers(tmp_path: Path) -> None:
    log = "\n\n" + HEAD.format(base="HEX", mode="SYSTEM") + "00:00:01:0 Rx 1 0x1 s 0\n"
    assert len(read(tmp_path, "made.log", log)) == 1
    with pytest.raises(TraceError, match="line 8: this is no frame"):
        read(tmp_path, "made.log", log + "nothing\n")


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("00:00:01:0 Rx 1 0x1 s 2 01", "line 6: 1 of 2 bytes"),
        ("00:00:01:0 Rx 1 0x800 s 0", "line 6: identifier 0x800 is too large"),
        ("00:00:01:0 Rx 1 0x1 q 0", "line 6: this is no frame"),
        ("***PROTOCOL J1939***", "line 6: a log of J1939: those of PROTOCOL CAN are read"),
    ],
)
def test_a_line_of_busmaster_that_is_no_frame_is_told_with_its_line(line: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(TraceError, match=why):
        busmaster(tmp_path, f"00:00:00:0 Rx 1 0x1 s 0\n{line}\n")


def test_both_versions_of_gvret(tmp_path: Path) -> None:
    (first,) = read(tmp_path, "a.csv", GVRET.format("") + "166064000,0000021A,false,3,2,FE,36,00,00,00,00,00,00,\n")
    (second,) = read(tmp_path, "b.csv", GVRET.format("Dir,") + "1500000,18DAF110,true,Tx,0,1,0A,,,,,,,\n")
    assert (first.arbitration_id, bytes(first.data), first.channel, first.is_rx) == (0x21A, b"\xfe\x36", 3, True)
    assert (second.arbitration_id, bytes(second.data), second.is_extended_id, second.is_rx) == (
        0x18DAF110,
        b"\x0a",
        True,
        False,
    )
    assert (first.timestamp, second.timestamp) == pytest.approx((166.064, 1.5))


def test_the_clock_of_gvret_begins_anew_and_times_go_on(tmp_path: Path) -> None:
    rows = "".join(f"{at},1,false,0,0,\n" for at in (2**32 - 1_000_000, 500_000, 2_500_000))
    found = read(tmp_path, "made.csv", GVRET.format("") + rows)
    assert [m.timestamp - found[0].timestamp for m in found] == pytest.approx([0.0, 1.5, 3.5])


@pytest.mark.parametrize(
    "row", ["1,1,maybe,0,0,", "1,800,false,0,0,", "1,1,false,0,3,00,11,", "x,1,false,0,0,", "1,1,false"]
)
def test_a_row_of_gvret_that_is_no_frame_is_told_with_its_line(row: str, tmp_path: Path) -> None:
    with pytest.raises(TraceError, match="line 3 is no frame"):
        read(tmp_path, "made.csv", GVRET.format("") + f"1,1,false,0,0,\n{row}\n")
    with pytest.raises(TraceError, match=r"made\.csv"):
        read(tmp_path, "made.csv", GVRET.format("") + row)
