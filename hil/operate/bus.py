"""`hil bus`: watch a CAN bus, record it, play a recording back."""

import contextlib
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Annotated

import can
import typer
from rich.console import Group
from rich.live import Live
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from drivers.bus.any_bus import open_bus
from drivers.bus.local_bus import from_message
from drivers.bus.port import PortError, resolve_interface
from drivers.config import BusConfig
from drivers.families.dbc.words import dbc_reader
from drivers.frame import REMOTE
from drivers.protocols.base import LayoutError
from drivers.protocols.dbc_codec import load_dbc
from drivers.protocols.frame_text import Reader, layout_reader
from hil.cli.console import plain_console
from hil.operate.bus_options import BitrateOption, InterfaceOption, OptionsOption, stated_bus
from hil.operate.bus_statistics import BusStatistics, identifier, kind, total
from hil.rig.file import load_rig
from hil.rig.schema import RigError
from hil.rig.segments import rig_on
from hil.runs.candump_log import TraceError
from hil.runs.trace_file import read_trace
from hil.runs.traces import open_writer, suffix_of

REFRESH_HZ = 4
POLL_S = 0.1
SHORTEST_WINDOW_S = 0.1
LAST_MESSAGES = 10_000  # taken after the end was asked for; more is a flood

bus = typer.Typer(no_args_is_help=True, help="Watch, record or play back a CAN bus.")

RigOption = Annotated[
    Path | None,
    typer.Option(
        "--rig", help="take channel (of several segments that of --channel), interface and bit rates from a rig file"
    ),
]
ChannelOption = Annotated[str, typer.Option("--channel", "-c", help="such as can0")]
SecondsOption = Annotated[float | None, typer.Option(min=0.0, help="end after this time; otherwise at Ctrl-C")]
_ANY_GAP = float(2**31)  # s between two frames, which is waited for; python-can would cut it to a minute


@bus.command(short_help="Show rate, load and last data by identifier")
def view(
    channel: ChannelOption = "can0",
    interface: InterfaceOption = "auto",
    bitrate: BitrateOption = 1_000_000,
    options: OptionsOption = None,
    rig: RigOption = None,
    dbc: Annotated[
        Path | None,
        typer.Option(exists=True, dir_okay=False, help="name signals by this DBC file; --rig: by its layout"),
    ] = None,
    seconds: SecondsOption = None,
) -> None:
    """Rate, load, age and last data per identifier, and errors; live in a terminal, once at the end otherwise."""
    config = _config(channel, interface, bitrate, options, rig)
    reader = _reader(rig, dbc, channel)
    console = plain_console()
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
                    live.update(_screen(statistics, config, now, reader), refresh=True)
                    next_refresh = now + 1.0 / REFRESH_HZ
        now = time.monotonic()
        statistics.roll(now, at_least=SHORTEST_WINDOW_S)
        console.print(_screen(statistics, config, now, reader))


@bus.command(short_help="Write all frames of the bus to a file")
def record(
    file: Annotated[Path, typer.Argument(help="candump .log (.log.gz), or Vector .blf")],
    channel: ChannelOption = "can0",
    interface: InterfaceOption = "auto",
    bitrate: BitrateOption = 1_000_000,
    options: OptionsOption = None,
    rig: RigOption = None,
    seconds: SecondsOption = None,
) -> None:
    """Write everything that goes over the bus to a file; Ctrl-C ends it with a complete file.

    Formats in which something would be lost are refused: others than .log and .blf have no place for FD flags, the
    lengths of remote frames or the classes of error frames.
    """
    config = _config(channel, interface, bitrate, options, rig)
    frames = errors = 0
    with _until_stopped(seconds) as stopped, _open(config) as member, _writer(file) as writer:
        for message in _messages(member, stopped):
            if message is None:
                continue
            writer(message)
            frames += not message.is_error_frame
            errors += message.is_error_frame
    print(f"{file}: {frames} frames, {errors} error frames from {config.channel}")


@bus.command(short_help="Send the frames of a recording")
def play(
    file: Annotated[
        Path, typer.Argument(exists=True, dir_okay=False, help="a recording: .log, .blf, .asc, .csv, .trc, .db")
    ],
    channel: ChannelOption = "can0",
    interface: InterfaceOption = "auto",
    bitrate: BitrateOption = 1_000_000,
    options: OptionsOption = None,
    rig: RigOption = None,
    *,
    speed: Annotated[float, typer.Option(min=0.001, help="2: twice as fast as recorded")] = 1.0,
    real: Annotated[bool, typer.Option("--real", help="also onto a real bus, where it may move a stage")] = False,
) -> None:
    """Send a recording's frames at their recorded intervals. Error frames are left out; refused frames are counted."""
    with _traces():
        suffix_of(file)
    config = _config(channel, interface, bitrate, options, rig)
    kind = resolve_interface(config)
    if kind != "local" and not real:
        raise typer.BadParameter(
            f"{config.channel} is a real bus ({kind}): recorded torques would move a stage; see --real"
        )
    sent = refused = 0
    trouble = ""
    with _open(config) as member, contextlib.suppress(KeyboardInterrupt):
        try:
            for message in can.MessageSync(_at_speed(read_trace(file), speed), gap=0.0, skip=_ANY_GAP):
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


def _config(channel: str, interface: str, bitrate: int, options: list[str] | None, rig: Path | None) -> BusConfig:
    if rig is not None:
        return rig_on(load_rig(rig), channel).bus
    return stated_bus(channel, interface, bitrate, options or [])


@contextlib.contextmanager
def _open(config: BusConfig) -> Iterator[can.BusABC]:
    """Join the bus with CAN FD where it can; exits with a message where it cannot be opened."""
    try:
        member = open_bus(config)
    except PortError as error:
        raise typer.BadParameter(str(error)) from None
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


@contextlib.contextmanager
def _traces() -> Iterator[None]:
    """A trace that cannot be read or written ends the command with its reason."""
    try:
        yield
    except TraceError as error:
        raise typer.BadParameter(str(error)) from None


def _writer(file: Path) -> contextlib.AbstractContextManager[Callable[[can.Message], None]]:
    with _traces():
        return open_writer(file)


def _reader(rig: Path | None, dbc: Path | None, channel: str) -> Reader | None:
    """What a frame means, by a DBC file or a rig's layout; None where neither is given."""
    if dbc is not None:
        try:
            return dbc_reader(load_dbc(dbc))
        except LayoutError as error:
            raise typer.BadParameter(str(error), param_hint="--dbc") from None
    if rig is None:
        return None
    config = rig_on(load_rig(rig), channel)
    rated = [axis.rated_force for axis in config.axes.values()]
    try:
        return layout_reader(config.bus, config.axis_names, rated, rig.parent, config.mountings)
    except ValueError as error:
        raise RigError([f"{rig}: {error}"]) from None


def _screen(statistics: BusStatistics, config: BusConfig, now: float, reader: Reader | None) -> Group:
    columns = ["id", "kind", "bytes", "frames", "1/s", "age ms", "data", *(["meaning"] if reader else [])]
    table = Table(*columns, title=f"bus {config.channel}")
    for row in statistics.rows(now):
        frame = row.frame
        data = "" if row.can_id & REMOTE else frame.data.hex(" ")
        shown = [f"{row.age * 1e3:.0f}", data, *([escape(reader(frame))] if reader else [])]
        table.add_row(
            identifier(row.can_id), kind(frame), str(len(frame.data)), str(row.count), f"{row.rate:.0f}", *shown
        )
    summary = (
        f"{statistics.received} frames, {statistics.rate:.0f}/s, load {statistics.load:.1%} at "
        f"{config.bitrate / 1e6:g}/{config.data_bitrate / 1e6:g} Mbit/s; errors: {total(statistics.errors.items())}"
    )
    return Group(table, Text(summary))
