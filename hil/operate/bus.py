"""`hil bus`: watch a CAN bus, record it, play a recording back. Files are read and written by python-can itself."""

import contextlib
import signal
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Literal

import can
import typer
from can.io.logger import Logger
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from drivers.bus.local_bus import from_message
from drivers.bus.port import resolve_interface
from drivers.config import CHANNEL_RULE, BusConfig
from hil.operate.bus_statistics import BusStatistics, identifier, kind, total
from hil.operate.trace_file import FORMATS, TraceError, has_known_format, read_trace
from hil.rig.file import load_rig

REFRESH_HZ = 4
POLL_S = 0.1
SHORTEST_WINDOW_S = 0.1
LAST_MESSAGES = 10_000  # taken after the end was asked for; more is a flood

bus = typer.Typer(no_args_is_help=True, help="Watch, record or play back a CAN bus.")

Interface = Literal["auto", "socketcan", "local"]
RigOption = Annotated[Path | None, typer.Option("--rig", help="take channel, interface and bit rates from a rig file")]
ChannelOption = Annotated[str, typer.Option("--channel", "-c", help="such as can0")]
InterfaceOption = Annotated[Interface, typer.Option("--interface", "-i", help="auto: SocketCAN where it exists")]
SecondsOption = Annotated[float | None, typer.Option(min=0.0, help="end after this time; otherwise at Ctrl-C")]


@bus.command()
def view(
    channel: ChannelOption = "can0",
    interface: InterfaceOption = "auto",
    rig: RigOption = None,
    seconds: SecondsOption = None,
) -> None:
    """Rate, load, age and last data per identifier, and errors; live in a terminal, once at the end otherwise."""
    config = _config(channel, interface, rig)
    console = Console()
    with _until_stopped(seconds) as stopped, _open(config) as member:
        statistics = BusStatistics(config.bitrate, config.data_bitrate, time.monotonic())
        with Live(console=console, auto_refresh=False, transient=True) as live:
            next_refresh = 0.0
            for message in _messages(member, stopped):
                now = time.monotonic()
                if message is not None:
                    statistics.add(from_message(message), now)
                statistics.roll(now)
                if console.is_terminal and now >= next_refresh:
                    live.update(_screen(statistics, config, now), refresh=True)
                    next_refresh = now + 1.0 / REFRESH_HZ
        now = time.monotonic()
        statistics.roll(now, at_least=SHORTEST_WINDOW_S)
        console.print(_screen(statistics, config, now))


@bus.command()
def record(
    file: Annotated[Path, typer.Argument(help="candump .log, Vector .asc or .blf, ...; .gz compresses where possible")],
    channel: ChannelOption = "can0",
    interface: InterfaceOption = "auto",
    rig: RigOption = None,
    seconds: SecondsOption = None,
) -> None:
    """Write everything that goes over the bus to a file; Ctrl-C ends it with a complete file."""
    _check_format(file)
    config = _config(channel, interface, rig)
    frames = errors = 0
    with _until_stopped(seconds) as stopped, _open(config) as member, Logger(file) as writer:
        for message in _messages(member, stopped):
            if message is None:
                continue
            writer(message)
            frames += not message.is_error_frame
            errors += message.is_error_frame
    print(f"{file}: {frames} frames, {errors} error frames from {config.channel}")


@bus.command()
def play(
    file: Annotated[Path, typer.Argument(exists=True, help="a recording in any format of `record`")],
    channel: ChannelOption = "can0",
    interface: InterfaceOption = "auto",
    rig: RigOption = None,
    speed: Annotated[float, typer.Option(min=0.001, help="2: twice as fast as recorded")] = 1.0,
    real: Annotated[bool, typer.Option("--real", help="also onto a real bus, where it may move a stage")] = False,
) -> None:
    """Send a recording's frames at their recorded intervals. Error frames are left out; refused frames are counted."""
    _check_format(file)
    config = _config(channel, interface, rig)
    if resolve_interface(config) == "socketcan" and not real:
        raise typer.BadParameter(
            f"{config.channel} is a SocketCAN bus: recorded torques would move a stage; see --real"
        )
    sent = refused = 0
    trouble = ""
    with _open(config) as member, contextlib.suppress(KeyboardInterrupt):
        try:
            for message in can.MessageSync(_at_speed(read_trace(file), speed), gap=0.0):
                try:
                    member.send(message)
                    sent += 1
                except can.CanOperationError:
                    refused += 1
        except TraceError as error:
            trouble = str(error)
    print(f"{file}: {sent} frames sent to {config.channel}, {refused} refused")
    if trouble:
        print(f"hil bus play: {trouble}", file=sys.stderr)
        raise typer.Exit(1)


def _messages(member: can.BusABC, stopped: threading.Event) -> Iterator[can.Message | None]:
    """What arrives, None after a while without anything; when stopped, what has arrived by then, and no more."""
    while not stopped.is_set():
        yield member.recv(POLL_S)
    for _ in range(LAST_MESSAGES):
        message = member.recv(0)
        if message is None:
            return
        yield message


def _at_speed(messages: Iterable[can.Message], speed: float) -> Iterator[can.Message]:
    for message in messages:
        if not message.is_error_frame:
            message.timestamp /= speed
            yield message


def _config(channel: str, interface: Interface, rig: Path | None) -> BusConfig:
    if rig is not None:
        return load_rig(rig).bus
    try:
        return BusConfig(channel=channel, interface=interface)
    except ValueError:
        raise typer.BadParameter(f"channel {channel!r}: {CHANNEL_RULE}") from None


@contextlib.contextmanager
def _open(config: BusConfig) -> Iterator[can.BusABC]:
    """Join the bus with CAN FD; exits with a message where it cannot be opened."""
    try:
        member = can.Bus(interface=resolve_interface(config), channel=config.channel, fd=True)
    except (can.CanError, OSError) as error:
        raise typer.BadParameter(f"bus {config.channel}: {error}") from None
    with member:
        yield member


@contextlib.contextmanager
def _until_stopped(seconds: float | None) -> Iterator[threading.Event]:
    """An event that is set by SIGINT, SIGTERM or after `seconds`; restores the previous signal handlers."""
    stopped = threading.Event()
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda *_: stopped.set()) for number in numbers]
    timer = threading.Timer(seconds, stopped.set) if seconds is not None else None
    if timer:
        timer.start()
    try:
        yield stopped
    finally:
        if timer:
            timer.cancel()
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def _check_format(file: Path) -> None:
    if not has_known_format(file):
        raise typer.BadParameter(f"{file}: the name must end in one of {', '.join(FORMATS)} (.gz may follow)")


def _screen(statistics: BusStatistics, config: BusConfig, now: float) -> Group:
    table = Table("id", "kind", "bytes", "frames", "1/s", "age ms", "data", title=f"bus {config.channel}")
    for row in statistics.rows(now):
        frame = row.frame
        shown = f"{row.age * 1e3:.0f}", frame.data.hex(" ")
        table.add_row(
            identifier(row.can_id), kind(frame), str(len(frame.data)), str(row.count), f"{row.rate:.0f}", *shown
        )
    summary = (
        f"{statistics.received} frames, {statistics.rate:.0f}/s, load {statistics.load:.1%} at "
        f"{config.bitrate / 1e6:g}/{config.data_bitrate / 1e6:g} Mbit/s; errors: {total(statistics.errors.items())}"
    )
    return Group(table, Text(summary))
