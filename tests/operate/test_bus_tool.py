"""`hil bus`: what is seen, recorded and played back is what went over the bus."""

import contextlib
import gzip
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from drivers.bus.error_frames import overflow_notice
from drivers.bus.port import Port, open_port
from drivers.config import BusConfig
from drivers.frame import BRS, EXTENDED, FD, REMOTE, Frame
from hil.operate import bus as bus_tool
from hil.operate.bus_statistics import BusStatistics, identifier, kind
from tests.support.paths import RIGS

PATIENCE_S = 60.0  # only a failing test waits this long
TRAFFIC = [
    Frame(0x080, bytes(range(24)), FD | BRS),
    Frame(0x100, bytes(range(16)), FD),
    Frame(0x18DA0102 | EXTENDED, b"abc"),
    Frame(0x7FF, b""),
    Frame(0x123 | REMOTE, bytes(5)),
]


@pytest.fixture
def port() -> Iterator[Port]:
    port = open_port(BusConfig(interface="local", channel="can0"), role="host", fd=True)
    yield port
    port.close()


def send_then_interrupt(port: Port) -> threading.Thread:
    """Send TRAFFIC as soon as somebody listens, then do what Ctrl-C does."""

    def run() -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not port._medium.others and time.monotonic() < deadline:  # type: ignore[attr-defined]
            port.drain(time.monotonic_ns())
        for frame in TRAFFIC:
            port.send(frame)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=run)
    thread.start()
    return thread


@pytest.mark.parametrize("suffix", [".log", ".blf", ".log.gz"])
def test_a_recording_plays_back_the_frames_that_were_recorded(port: Port, tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"trace{suffix}"
    sender = send_then_interrupt(port)
    bus_tool.record(file, channel="can0", interface="local")
    sender.join()
    port.drain(time.monotonic_ns())
    bus_tool.play(file, channel="can0", interface="local", speed=1000.0)
    assert [frame._replace(timestamp_ns=0) for frame in port.drain(time.monotonic_ns())] == TRAFFIC


def test_a_recording_keeps_the_intervals(port: Port, tmp_path: Path) -> None:
    file = tmp_path / "trace.log"
    file.write_text("(1000.000000) can0 100#01\n(1000.050000) can0 100#02\n")
    start = time.monotonic()
    bus_tool.play(file, channel="can0", interface="local")
    assert time.monotonic() - start >= 0.05
    assert [frame.data for frame in port.drain(time.monotonic_ns())] == [b"\x01", b"\x02"]


def test_the_view_ends_with_what_it_has_seen(port: Port, capsys: pytest.CaptureFixture[str]) -> None:
    sender = send_then_interrupt(port)
    bus_tool.view(channel="can0", interface="local")
    sender.join()
    shown = capsys.readouterr().out
    for text in ("080", "FD BRS", "18DA0102", "61 62 63", "5 frames", "errors: none"):
        assert text in shown


def test_a_recording_never_reaches_a_real_bus_by_accident(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = tmp_path / "trace.log"
    file.write_text("(1000.0) can0 100#01\n")
    monkeypatch.setattr(bus_tool, "resolve_interface", lambda config: "socketcan")
    with pytest.raises(typer.BadParameter, match="would move a stage"):
        bus_tool.play(file, channel="can0", interface="auto")


@pytest.mark.parametrize("name", ["trace", "trace.txt", "trace.gz"])
def test_an_unknown_format_is_refused_with_the_known_ones(name: str, tmp_path: Path) -> None:
    with pytest.raises(typer.BadParameter, match=r"must end in one of \.log, \.blf, \.asc"):
        bus_tool.record(tmp_path / name)


@pytest.mark.parametrize("suffix", [".asc", ".csv", ".db", ".trc"])
def test_a_format_that_loses_something_is_refused_before_the_bus_is_joined(suffix: str, tmp_path: Path) -> None:
    with pytest.raises(typer.BadParameter, match=r"not recorded as .*\.log and \.blf keep everything"):
        bus_tool.record(tmp_path / f"trace{suffix}", channel="can0", interface="local")


@pytest.mark.parametrize("suffix", [".log", ".log.gz", ".blf", ".asc", ".csv", ".db", ".trc"])
def test_a_damaged_trace_is_named_and_is_no_traceback(
    suffix: str, port: Port, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / f"trace{suffix}"
    content = b"\xff\x00no trace at all\n" * 9
    file.write_bytes(gzip.compress(content) if suffix.endswith(".gz") else content)
    with contextlib.suppress(typer.Exit):  # some formats are read as far as lines make sense, which is none
        bus_tool.play(file, channel="can0", interface="local")
    told = capsys.readouterr()
    assert str(file) in told.out
    assert "Traceback" not in told.err
    assert port.drain(time.monotonic_ns()) == []


def test_the_view_names_signals_by_a_dbc_file_or_a_layout(port: Port, capsys: pytest.CaptureFixture[str]) -> None:
    sent = TRAFFIC.copy()
    try:
        TRAFFIC[:] = [Frame(0x009, bytes.fromhex("0000803f00000040"))]  # of node 0: 1 turn, 2 turns a second
        sender = send_then_interrupt(port)
        bus_tool.view(channel="can0", interface="local", dbc=RIGS / "odrive_cansimple.dbc")
        sender.join()
    finally:
        TRAFFIC[:] = sent
    shown = " ".join(capsys.readouterr().out.split())
    assert "meaning" in shown
    assert "Pos_Estimate" in shown


def test_an_impossible_channel_is_refused() -> None:
    with pytest.raises(typer.BadParameter, match="channel 'a/b'"):
        bus_tool.view(channel="a/b")


def test_rates_and_load_are_those_of_the_window() -> None:
    statistics = BusStatistics(1_000_000, 5_000_000, 0.0)
    frame = Frame(0x100, bytes(8))
    for number in range(1000):
        statistics.add(frame, number / 1000)
    statistics.roll(0.5)
    assert statistics.rate == 0.0
    statistics.roll(1.0)
    assert statistics.rate == 1000.0
    assert statistics.load == pytest.approx(1000 * statistics.duration(frame))
    assert 0.111 <= statistics.load <= 0.135  # 111 bits unstuffed with intermission, 135 at most
    (row,) = statistics.rows(1.5)
    assert (row.count, row.rate, row.age) == (1000, 1000.0, pytest.approx(0.501))
    statistics.roll(2.0)
    assert (statistics.rate, statistics.load, statistics.rows(2.0)[0].rate) == (0.0, 0.0, 0.0)


def test_the_data_phase_counts_at_its_own_rate() -> None:
    slow, fast = BusStatistics(1_000_000, 1_000_000, 0.0), BusStatistics(1_000_000, 5_000_000, 0.0)
    frame = Frame(0x100, bytes(64), FD | BRS)
    assert fast.duration(frame) < 0.4 * slow.duration(frame)


def test_error_frames_are_counted_by_what_they_say_and_not_as_traffic() -> None:
    statistics = BusStatistics(1_000_000, 5_000_000, 0.0)
    for _ in range(2):
        statistics.add(overflow_notice(9), 0.0)
    assert statistics.received == 0
    assert statistics.rows(0.0) == []
    assert dict(statistics.errors) == {"receive overflow": 2}


def test_identifiers_and_kinds_are_written_as_people_know_them() -> None:
    assert [identifier(frame.can_id) for frame in TRAFFIC] == ["080", "100", "18DA0102", "7FF", "123"]
    assert [kind(frame) for frame in TRAFFIC] == ["FD BRS", "FD", "classic", "classic", "remote"]
