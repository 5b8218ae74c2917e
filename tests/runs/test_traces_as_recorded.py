"""Trace files as other programs recorded them: every frame, its kind and its time; errors with file and line."""

from pathlib import Path

import can
import pytest

from hil.runs.candump_log import TraceError
from hil.runs.trace_file import read_trace

HEAD = "date Mon Nov 23 06:24:08.846 pm 2026\nbase {base}  timestamps {times}\n"


def read(folder: Path, name: str, text: str) -> list[can.Message]:
    (folder / name).write_text(text)
    return list(read_trace(folder / name))


def asc(folder: Path, lines: str, base: str = "hex", times: str = "absolute") -> list[can.Message]:
    return read(folder, "made.asc", HEAD.format(base=base, times=times) + lines)


def kinds(messages: list[can.Message]) -> list[tuple[int, bool, bool, bool, int]]:
    """Identifier, FD, BRS, remote, length."""
    return [(m.arbitration_id, m.is_fd, m.bitrate_switch, m.is_remote_frame, m.dlc) for m in messages]


FLAGS = "   103625  136   {flags} 98005364 4ba00150 4b280150 20002776 2000091c\n"


def test_a_canfd_line_says_by_its_flags_what_it_is(tmp_path: Path) -> None:
    data = "8  8 f8 62 01 00 00 40 00 00" + FLAGS
    found = asc(
        tmp_path,
        "Begin TriggerBlock\n   0.000000 Start of measurement\n"
        f"   0.001036 CANFD   1 Rx        29a                0 0 {data.format(flags='200040')}"
        f"   0.002036 CANFD   1 Rx        29b                0 0 5  0{FLAGS.format(flags='200050')}"
        f"   0.003036 CANFD   2 Tx        29cx  SomeName     1 1 {data.format(flags='303040')}"
        f"   0.004036 CANFD   1 Rx        29d                0 0 9 12{' 11' * 12}{FLAGS.format(flags='1040')}"
        f"   0.005036 CANFD   1 Rx        29e                0 0 0  0{FLAGS.format(flags='301040')}"
        "End TriggerBlock\n",
    )
    assert kinds(found) == [
        (0x29A, False, False, False, 8),
        (0x29B, False, False, True, 5),
        (0x29C, True, True, False, 8),
        (0x29D, True, False, False, 12),
        (0x29E, True, False, False, 0),
    ]
    third = found[2]
    assert (third.is_extended_id, third.error_state_indicator, third.is_rx, third.channel) == (True, True, False, 1)


def test_a_remote_frame_may_have_no_length_before_what_is_told_of_it(tmp_path: Path) -> None:
    facts = "Length = 1704000 BitCount = 145 ID = 88888888x"
    lines = f"   2.5 2 100 Tx r\n   2.6 3 200 Tx r {facts}\n   2.7 4 300 Tx r 8 {facts}\n"
    assert [kind[3:] for kind in kinds(asc(tmp_path, lines))] == [(True, 0), (True, 0), (True, 8)]


def test_decimal_files_and_relative_times(tmp_path: Path) -> None:
    found = asc(
        tmp_path,
        "no internal events logged\nBegin TriggerBlock\n   0.100000 1  1378   Rx   d 8 98 1 0 0 0 0 255 255\n"
        "   0.100000 1  1378   Rx   d 2 16 17\n   0.100000 1  Statistic: D 0 R 0\n"
        "   0.100000 1  419361280x  Rx   r 3\n",
        "dec",
        "relative",
    )
    assert [round(message.timestamp, 6) for message in found] == [0.1, 0.2, 0.4]  # the event's time counts, too
    assert kinds(found) == [
        (0x562, False, False, False, 8),
        (0x562, False, False, False, 2),
        (0x18FEF200, False, False, True, 3),
    ]
    assert bytes(found[0].data) == bytes((98, 1, 0, 0, 0, 0, 255, 255))


@pytest.mark.parametrize(
    "head",
    ["", "internal events logged\n", "// version 11.0.0\n", "Begin TriggerBlock Mon\n", "Begin Triggerblock\n"],
)
def test_no_frame_is_lost_behind_any_header(head: str, tmp_path: Path) -> None:
    frames = "   0.100000 1  562   Rx   d 2 98 01\n  -0.200000 1  563   Tx   d 0\n   0.3 1  ErrorFrame\n"
    found = asc(tmp_path, head + frames)
    assert [message.timestamp for message in found] == [0.1, -0.2, 0.3]
    assert [message.is_error_frame for message in found] == [False, False, True]
    assert kinds(read(tmp_path, "bare.asc", frames))[0] == (0x562, False, False, False, 2)


@pytest.mark.parametrize(
    "line",
    [
        "   0.1 1  562   Rx   d 3 98 01",
        "   0.1 1  862   Rx   d 1 98",
        "   0.1 1  562   Rx   d 1 zz",
        "   0.1 1  562   Rx   q 1 98",
        "   0.1 CANFD   1 Rx  29a  0 0 9 12 11 22",
    ],
)
def test_a_line_that_is_no_frame_is_told_with_file_and_line(line: str, tmp_path: Path) -> None:
    with pytest.raises(TraceError, match=r"made\.asc: .*line 4"):
        asc(tmp_path, "   0.100000 1  562   Rx   d 2 98 01\n" + line + "\n")


def test_what_candump_shows_on_a_screen(tmp_path: Path) -> None:
    found = read(
        tmp_path,
        "screen.log",
        "  can0  123   [2]  01 02\n"
        "  can0  18FF1234   [8]  01 02 03 04 05 06 07 08   '........'\n"
        " (1700000000.368435)  can0       0C0  [12]  01 02 03 04 05 06 07 08 09 0A 0B 0C\n"
        "  can0  20000004   [8]  00 08 00 00 00 00 60 00   ERRORFRAME\n"
        "  can1  TX B -  124  [08]  01 02 03 04 05 06 07 08\n"
        "  can0  125   [3]  remote request\n",
    )
    assert kinds(found) == [
        (0x123, False, False, False, 2),
        (0x18FF1234, False, False, False, 8),
        (0x0C0, True, False, False, 12),
        (0x004, False, False, False, 8),
        (0x124, True, True, False, 8),
        (0x125, False, False, True, 3),
    ]
    assert found[2].timestamp == 1700000000.368435
    assert [message.is_error_frame for message in found] == [False, False, False, True, False, False]
    assert not found[4].is_rx
    with pytest.raises(TraceError, match="line 1"):
        read(tmp_path, "cut.log", "  can0  123   [3]  01 02\n")
