"""`hil monitor`: a rig in the terminal, over Zenoh, from any machine that reaches the sidecar."""

import math
import sys
import time
from collections import deque
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from drivers.protocols.base import UNHEALTHY, DriveStatus
from hil.cli.console import plain_console
from hil.cli.exit_status import EXIT_UNAVAILABLE
from hil.cli.output import metres
from hil.operate.estop import stop_rig
from hil.operate.keys import Keys
from hil.telemetry import events_pb2 as pb_events
from hil.telemetry import telemetry_pb2 as pb
from hil.telemetry.client import NoSidecarError, RigClient, find_endpoint
from hil.telemetry.credentials import Credentials
from hil.telemetry.window import silent_axes

STALE_S = 0.5  # a status comes ten times a second, a tick a hundred times and more
POLL_S = 0.05
FIRST_S = 30.0
LINE_INTERVAL_S = 0.5  # without a terminal

EVENTS_KEPT, EVENTS_SHOWN = 200, 8
STOP_KEY = "e"
STOP_HINT = "on the rig's machine: e stops (as hil estop does)"

_EVENT_STYLES = {
    pb_events.Event.CRITICAL: "bold red",
    pb_events.Event.ERROR: "bold red",
    pb_events.Event.WARNING: "yellow",
}
_STATE_STYLES = {"ACTIVE": "bold green", "HOMING": "green", "READY": "cyan", "FAULT": "bold red", "ESTOP": "bold red"}


def silence(status: pb.Status | None, age_s: float) -> str:
    """What is dead though it was alive, and how long; empty where all are alive. age_s: of the status."""
    if status is None:
        return "no sidecar answers"
    if age_s > STALE_S:
        return f"NO WORD FROM THE SIDECAR for {age_s:.1f} s; what is shown is as old"
    ticked_s = (status.now_ns - status.tick_ns) * 1e-9
    if status.control_alive and status.tick_ns and ticked_s > STALE_S:
        return f"THE CONTROL PROCESS HANGS: no tick for {ticked_s + age_s:.1f} s; what is shown is as old"
    return ""


def control_line(status: pb.Status, age_s: float = 0.0) -> Text:
    """State, fault and fate of the control process. age_s: of the status."""
    text = Text()
    if dead := silence(status, age_s):
        text.append(f"{dead}; it was ", style="bold red")
    text.append(status.state or "-", style="dim" if dead else _STATE_STYLES.get(status.state, "yellow"))
    if status.motion not in ("", "NONE"):
        text.append(f" {status.motion.lower()}", style="dim" if dead else "")
    if status.fault not in ("", "NONE"):
        text.append(f"  fault {status.fault}", style="bold red")
    if status.faults_active:
        text.append(f"  seen now: {', '.join(status.faults_active)}", style="red")
    if status.tip:
        text.append(f"\n  {status.tip}", style="bold red")
    for problem in status.drive_problems:
        text.append(f"\n  drive not ready: {problem}", style="bold red")
    if silent := silent_axes(status.axes, status.answer_age):
        text.append(f"\n  {silent}", style="bold red")
    if not status.control_alive:
        fate = "ended" if status.control_ended else "was killed" if status.pid else "is not running"
        text.append(f"  the control process {fate}", style="yellow" if status.control_ended else "bold red")
    return text


def drive_words(bits: int) -> Text:
    """What a drive says of itself. In red what keeps the rig from READY."""
    text = Text()
    for flag in DriveStatus(bits):
        text.append(f"{(flag.name or '').lower().replace('_', ' ')} ", style="bold red" if flag & UNHEALTHY else "")
    return text


def axis_rows(status: pb.Status) -> Table:
    """Per axis: where it is, where it should be, the largest error of the last second, the force, the drive's word."""
    table = Table("axis", "position", "setpoint", "max error, last s", "force", "drive", expand=True)
    columns = (status.axes, status.units, status.position, status.setpoint, status.max_error, status.force)
    for name, unit, position, setpoint, error, force, drive in zip(*columns, status.drive_status, strict=False):
        table.add_row(
            Text(name),
            Text(f"{position * 1e3:+.6f} m{unit}"),
            Text("-" if math.isnan(setpoint) else f"{setpoint * 1e3:+.6f} m{unit}"),  # no task is followed
            metres(error, "linear" if unit == "m" else "rotary"),
            f"{force:+.4f} {'N' if unit == 'm' else 'N m'}",
            drive_words(drive),
        )
    return table


def counter_rows(status: pb.Status) -> Table:
    """Lateness, losses, telemetry."""
    counts = status.counters
    late = [f"{value * 1e6:.0f}" for value in (status.lateness_p50, status.lateness_p99, status.lateness_max)]
    table = Table.grid(padding=(0, 2))
    table.add_row("tick lateness", "p50 {} / p99 {} / max {} µs over the last second".format(*late))
    missed = f"{counts.missed_own} own, {counts.missed_host} the host's"
    table.add_row("missed ticks", missed)
    lost = f"{counts.samples_lost} samples lost, {sum(counts.rejects)} frames rejected, {counts.refused} refused"
    table.add_row("frames", f"{counts.sent} sent, {counts.received} received; {lost}")
    recording = "recording" if status.recording else "not recording"
    table.add_row("telemetry", f"{status.sent} ticks sent, {status.dropped} dropped; {recording}")
    table.add_row("real time", Text(status.realtime or "-"))
    return table


def event_lines(events: Iterable[pb_events.Event]) -> Text:
    """The events in words, the newest last, one line each with its wall clock."""
    text = Text()
    for event in events:
        at = time.strftime("%H:%M:%S", time.localtime(event.wall_ns * 1e-9))
        text.append(f"{at} {event.line}\n", style=_EVENT_STYLES.get(event.severity, ""))
    text.rstrip()
    return text


def banner(status: pb.Status, events: Sequence[pb_events.Event]) -> Text:
    """The fault that is latched: when, which axis, measured, limit, cause, what to do next; empty where none is."""
    if status.fault in ("", "NONE"):
        return Text()
    if status.HasField("latched"):
        return Text(status.latched.line, style="bold white on red")
    latched = [
        event for event in events if event.kind == pb_events.Event.FAULT_LATCHED and event.name == status.fault.lower()
    ]
    return Text(latched[-1].line if latched else f"fault {status.fault}", style="bold white on red")


def view(status: pb.Status, age_s: float = 0.0, events: Sequence[pb_events.Event] = ()) -> RenderableType:
    """The whole picture. age_s: of the status. events: so far, of which the last few are shown."""
    title = (
        f"{status.rig} · {status.law} · {1e9 / status.period_ns if status.period_ns else 0:g} Hz · tick {status.index}"
    )
    return Panel(
        Group(
            *([banner(status, events)] if status.fault not in ("", "NONE") else []),
            control_line(status, age_s),
            axis_rows(status),
            counter_rows(status),
            *([event_lines(events[-EVENTS_SHOWN:])] if events else []),
        ),
        title=Text(title),
        subtitle=STOP_HINT,
    )


def line(status: pb.Status, age_s: float = 0.0) -> str:
    """The same in one line, where there is no terminal."""
    errors = " ".join(
        f"{name} {metres(error, 'linear' if unit == 'm' else 'rotary')}"
        for name, unit, error in zip(status.axes, status.units, status.max_error, strict=False)
    )
    late = f"late p99 {status.lateness_p99 * 1e6:.0f} max {status.lateness_max * 1e6:.0f} us"
    return f"tick {status.index:>7}  {control_line(status, age_s).plain}  max error {errors or '-'}  {late}"


def monitor(
    rig: Annotated[str | None, typer.Argument(help="name of the rig [any]")] = None,
    connect: Annotated[str | None, typer.Option(help="Zenoh endpoint of the sidecar [found by itself]")] = None,
    key: Annotated[str, typer.Option(help="[telemetry] key of the rig file")] = "hil",
    credentials: Annotated[Path | None, typer.Option(help="directory, for an endpoint tls/...")] = None,
    once: Annotated[bool, typer.Option("--once", help="print one snapshot and leave")] = False,
) -> None:
    """Watch a rig until Ctrl-C. Exit status 69: no sidecar answers (with --once)."""
    console = plain_console()
    endpoint = connect or find_endpoint(rig)
    try:
        with RigClient(endpoint, key, rig or "*", Credentials(credentials) if credentials else None) as client:
            if once:
                status = client.wait_status(3.0)
                console.print(view(status, events=client.wait_events(3.0)))
            else:
                _watch(client, console)
    except NoSidecarError as error:
        print(f"hil monitor: {error}", file=sys.stderr)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    except KeyboardInterrupt:
        if once:
            raise


class Newest:
    """The newest status and its age, s; the newest events. fresh: those that came with the last look."""

    def __init__(self, client: RigClient) -> None:
        self._client = client
        self._heard_s = time.monotonic()
        self.status: pb.Status | None = None
        self.events: deque[pb_events.Event] = deque(maxlen=EVENTS_KEPT)
        self.fresh: list[pb_events.Event] = []

    def look(self) -> bool:
        """Take a newer one in; False where there is none."""
        status = self._client.status()
        self.fresh = self._client.events()
        self.events.extend(self.fresh)
        if status:
            self.status, self._heard_s = status, time.monotonic()
        return status is not None

    @property
    def age_s(self) -> float:
        """Since it came; of none since the start."""
        return time.monotonic() - self._heard_s


def _watch(client: RigClient, console: Console) -> None:
    if not console.is_terminal:
        _watch_lines(client, console)
        return
    waiting = Text(f"waiting for a sidecar at {client.endpoint} (hil sidecar RIG, or hil demo RIG); Ctrl-C ends")
    newest = Newest(client)
    with Live(waiting, console=console, auto_refresh=False, transient=False) as live, Keys(0) as keys:
        while True:
            if (newest.look() or newest.age_s > STALE_S) and newest.status:
                live.update(view(newest.status, newest.age_s, list(newest.events)), refresh=True)
            if STOP_KEY in keys.within(POLL_S) and newest.status:
                stop_rig(newest.status.rig)  # what it prints appears above the picture


def _watch_lines(client: RigClient, console: Console) -> None:
    newest = Newest(client)
    due_s = 0.0
    while True:
        newest.look()
        if newest.fresh:
            console.print(event_lines(newest.fresh), soft_wrap=True)
        if newest.status is None and newest.age_s > FIRST_S:
            raise NoSidecarError(f"no sidecar answers at {client.endpoint}")
        if newest.status and time.monotonic() >= due_s:
            console.print(line(newest.status, newest.age_s), soft_wrap=True, markup=False)
            due_s = time.monotonic() + LINE_INTERVAL_S
        time.sleep(POLL_S)
