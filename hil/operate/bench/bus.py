"""`hil bench bus`: round trip, jitter and loss of this machine's CAN adapter and the drives behind it.

A rig's drives are configured as `hil run` does it, then told zero force, every one disabled, tick by tick. What is
measured is the time from handing the command frames to the bus to the reception of each drive's answer. The kernel
stamps it, or, with an adapter that only python-can knows, a thread that reads. An answer that takes longer than a
tick is taken for one to the next command, and shows as the tick without an answer it left behind.

Without a rig, one CANopen node is asked for its device type (1000h) again and again.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from drivers.bus.any_bus import AnyPort, joined
from drivers.bus.port import PortError
from drivers.families.cia402 import cia301
from drivers.families.cia402.sdo import Progress, Step, Transfer
from drivers.frame import Frame
from hil.cli.console import plain_console
from hil.cli.exit_status import EXIT_UNAVAILABLE
from hil.cli.options import JsonTarget, Overrides, any_rig
from hil.cli.output import write_json
from hil.live.stop_line import RigInUseError
from hil.operate.bringup.drive_host import DriveHost
from hil.operate.bringup.session import open_session
from hil.operate.bringup.survey import Survey
from hil.operate.bus_options import BitrateOption, InterfaceOption, OptionsOption, stated_bus
from hil.rig.bus_load import feedback_ns
from hil.rig.file import load_rig
from hil.rig.schema import RigError
from hil.rig.segments import segment_rigs

_LOST = 1.5  # periods without an answer in a drive's own time: one was lost
_SDO_TIMEOUT_S = 0.5
_MEASURED, _QUIET = "answer behind the command", "period in the drives' own time"


@dataclass
class Line:
    """One drive. times_ns: of its answers, or their periods. expected: how many there should have been."""

    name: str
    times_ns: list[int] = field(default_factory=list)
    expected: int = 0

    @property
    def lost(self) -> int:
        """Answers that did not come in time."""
        return max(0, self.expected - len(self.times_ns))

    def figures(self) -> dict[str, Any]:
        """In microseconds; jitter: between the 1st and the 99th percentile."""
        shown: dict[str, Any] = {"name": self.name, "expected": self.expected, "lost": self.lost}
        if self.times_ns:
            low, middle, high = np.percentile(self.times_ns, [1, 50, 99]) / 1e3
            shown |= {"p50_us": middle, "p99_us": high, "max_us": max(self.times_ns) / 1e3, "jitter_us": high - low}
        return shown


class Exchange:
    """The procedure: zero force in every tick, and when each drive answers. `lines` are in axis order."""

    def __init__(self, host: DriveHost, ticks: int, clock: Callable[[], int] = time.monotonic_ns) -> None:
        """clock: of the frames' stamps, ns."""
        self.host = host
        self._clock = clock
        self.lines = [Line(name) for name in host.rig.axis_names]
        self.triggered = not host.protocol.acts_ns
        self._left = ticks
        self._sent_ns = 0
        self._last_ns = [0] * len(self.lines)
        self._period_ns = host.rig.period_ns
        if not self.triggered:
            self._period_ns = feedback_ns(host.protocol) or self._period_ns

    @property
    def done(self) -> bool:
        """All ticks are over."""
        return self._left <= 0

    def step(self, now_ns: int, frames: Sequence[Frame]) -> list[Frame]:
        """One tick."""
        self.host.take(frames, now_ns)
        (self._note_answers if self.triggered else self._note_periods)()
        self._left -= 1
        command = self.host.zero()
        self._sent_ns = self._clock()
        return command

    def _note_answers(self) -> None:
        if not self._sent_ns:
            return
        first = {axis: stamp for axis, stamp in reversed(self.host.stamps) if stamp >= self._sent_ns}
        for axis, line in enumerate(self.lines):
            line.expected += 1
            if axis in first:
                line.times_ns.append(first[axis] - self._sent_ns)

    def _note_periods(self) -> None:
        for axis, stamp in self.host.stamps:
            line, last_ns = self.lines[axis], self._last_ns[axis]
            self._last_ns[axis] = stamp
            if last_ns:
                line.times_ns.append(stamp - last_ns)
                missed = stamp - last_ns > _LOST * self._period_ns
                line.expected += round((stamp - last_ns) / self._period_ns) if missed else 1


def bus(
    rig: Annotated[
        Path | None,
        typer.Argument(
            metavar="[RIG]", callback=any_rig, show_default=False, help="rig file, or a shipped or running rig"
        ),
    ] = None,
    *,
    seconds: Annotated[float, typer.Option(min=0.1, max=3600, help="of measuring")] = 5.0,
    node: Annotated[int | None, typer.Option(min=1, max=127, help="instead of RIG: ask this CANopen node")] = None,
    channel: Annotated[str, typer.Option("--channel", "-c", help="--node: such as can0")] = "can0",
    interface: InterfaceOption = "auto",
    bitrate: BitrateOption = 1_000_000,
    options: OptionsOption = None,
    overrides: Overrides = None,
    json_file: JsonTarget = "",
) -> None:
    """Round trip, jitter and loss of your own adapter and drives, without torque: exit status 1 where none answered."""
    if (rig is None) == (node is None):
        raise typer.BadParameter("name a rig, or a CANopen node with --node")
    try:
        if rig is not None:
            what, lines = _measure_rig(rig, overrides or [], seconds)
        else:
            assert node is not None
            with joined(stated_bus(channel, interface, bitrate, options or []), fd=False) as port:
                what, lines = "answer to an SDO read of 1000h", [ask(port, node, seconds)]
    except (PortError, RigInUseError) as error:
        typer.echo(f"hil bench bus: {error}", err=True)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    document = {"measured": what, "seconds": seconds, "lines": [line.figures() for line in lines]}
    if json_file:
        write_json(document, json_file)
    if json_file != "-":
        _show(document)
    if not any(line.times_ns for line in lines):
        raise typer.Exit(1)


def _measure_rig(path: Path, overrides: list[str], seconds: float) -> tuple[str, list[Line]]:
    lines: list[Line] = []
    for rig in segment_rigs(load_rig(path, overrides)):  # one after the other
        try:
            with open_session(rig, path.parent) as session:
                session.run(Survey(session.host))
                exchange = Exchange(session.host, round(seconds * rig.rate_hz))
                session.run(exchange)
        except ValueError as error:
            raise RigError([f"{path}: {error}"]) from None
        lines += exchange.lines
    return _MEASURED if exchange.triggered else _QUIET, lines


def ask(port: AnyPort, node: int, seconds: float) -> Line:
    """Ask a CANopen node for its device type, again and again."""
    line = Line(f"node {node}")
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        port.drain(0)
        transfer = Transfer(Step(0x1000, 0, 0))
        start_ns = time.monotonic_ns()
        port.send(Frame(cia301.SDO_REQUEST_ID + node, transfer.request()))
        line.expected += 1
        answered_ns = _answer(port, node, transfer)
        if answered_ns:
            line.times_ns.append(answered_ns - start_ns)
    return line


def _answer(port: AnyPort, node: int, transfer: Transfer) -> int:
    """When the transfer's first answer came; 0 where it did not. The rest of a segmented answer is fetched, too."""
    first_ns, deadline = 0, time.monotonic() + _SDO_TIMEOUT_S
    while (left := deadline - time.monotonic()) > 0:
        frame = port.wait(left)
        if frame is None or frame.can_id != cia301.SDO_RESPONSE_ID + node or len(frame.data) != 8:
            continue
        progress = transfer.answer(frame.data)
        if progress is not Progress.FOREIGN:
            first_ns = first_ns or frame.timestamp_ns
        if progress is Progress.CONTINUE:
            port.send(Frame(cia301.SDO_REQUEST_ID + node, transfer.request()))
        elif progress is not Progress.FOREIGN:
            if transfer.closing:
                port.send(Frame(cia301.SDO_REQUEST_ID + node, transfer.closing))
            break
    return first_ns


def _show(document: dict[str, Any]) -> None:
    table = Table("", "p50 us", "p99 us", "longest us", "jitter us", "lost", title=document["measured"])
    for line in document["lines"]:
        times = [f"{line[key]:.0f}" if key in line else "-" for key in ("p50_us", "p99_us", "max_us", "jitter_us")]
        table.add_row(line["name"], *times, f"{line['lost']} of {line['expected']}")
    plain_console(highlight=False).print(table)
