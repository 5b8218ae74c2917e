"""`hil move RIG x=1mm`, `hil jog RIG x=2mm/s`, `hil stream RIG`: move a running rig under torque, from this machine.

They bring the axes to rest when they end, also on Ctrl-C, and leave the rig holding. None puts a rig under torque.
"""

import contextlib
import csv
import math
import signal
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated

import typer

from drivers.base.runtime import RuntimeDirectoryError
from hil.cli.exit_status import EXIT_UNAVAILABLE
from hil.cli.quantity import positions, quantities
from hil.cycle.goal import GoalRefusedError, MotionError
from hil.live.goal_link import Look
from hil.operate.command import config_of
from hil.operate.jog_gamepad import by_gamepad
from hil.operate.jog_keys import by_keys
from hil.operate.moving import motion
from hil.rig.task_file import TIME
from hil.runs.mover import Mover
from hil.runs.streaming import LEAD_S, Row
from hil.telemetry.command_client import NoGatewayError

JOG_S = 0.2  # what each goal of a jog lasts; the next one comes long before
REPEAT_S = 0.05
INTERRUPTED = 130

RunningRig = Annotated[
    Path, typer.Argument(metavar="RIG", help="name of a running rig, or its rig file", show_default=False)
]
Take = Annotated[bool, typer.Option("--take", help="also where another client moves the rig")]


def move(
    rig: RunningRig,
    targets: Annotated[list[str], typer.Argument(metavar="AXIS=VALUE", help="1mm, -20um, 0.5deg; bare: m, rad")],
    *,
    by: Annotated[bool, typer.Option("--by", help="move by these distances from the present target")] = False,
    speed: Annotated[float, typer.Option(help="share of the axes' motion limits, above 0 to 1")] = 1.0,
    line: Annotated[bool, typer.Option("--line", help="along the straight line; from rest only")] = False,
    take: Take = False,
) -> None:
    """Move axes and wait until they are in position. Exit status 0: they are; 1: refused; 69: cut short, never in
    position, or the rig does not run here; each with the reason.
    """
    with _moving("move", rig, take) as mover:
        values = quantities(targets, mover.kinds)
        goal = (mover.move_by if by else mover.move_to)(speed=speed, line=line, **values)
        _say(mover, goal.wait())


def jog(
    rig: RunningRig,
    speeds: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[AXIS=SPEED]...", help="2mm/s, -1deg/s; bare: m/s, rad/s; without any, the keys move it"
        ),
    ] = None,
    *,
    seconds: Annotated[float, typer.Option(help="how long, at most 60")] = 0.5,
    gamepad: Annotated[bool, typer.Option("--gamepad", help="by a gamepad instead of keys")] = False,
    device: Annotated[str | None, typer.Option(help="of the gamepad, /dev/input/event5 [the first one]")] = None,
    take: Take = False,
) -> None:
    """Move axes at a speed for a time, then bring them to rest; or by the keys of this terminal, until q; or by a
    gamepad, while one of its shoulder buttons is held.

    Exit status as `hil move`.
    """
    if not 0.0 < seconds <= 60.0:
        raise typer.BadParameter(f"{seconds:g}: above 0, at most 60", param_hint="--seconds")
    if speeds and gamepad:
        raise typer.BadParameter("sticks give the speeds: leave AXIS=SPEED out", param_hint="--gamepad")
    with _moving("jog", rig, take) as mover:
        if gamepad:
            by_gamepad(mover, config_of(rig).name, device)
            return
        if not speeds:
            by_keys(mover, config_of(rig).name)
            return
        values = quantities(speeds, mover.kinds, speed=True)
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0.0:
            mover.jog(seconds=max(min(JOG_S, left), 1e-3), **values)
            mover.sleep(min(REPEAT_S, left))
        _say(mover, mover.wait())


def stream(
    rig: RunningRig,
    file: Annotated[
        Path | None, typer.Argument(metavar="[FILE.csv]", help="rows as they come; without it, standard input")
    ] = None,
    *,
    lead: Annotated[float, typer.Option(help="s from a row's time until it is reached, at most 10")] = LEAD_S,
    take: Take = False,
) -> None:
    """Move axes through timed rows as they come: a header line `time_s,AXIS,...`, then numbers in s, m, rad. Goes to
    the first row at once. Exit status as `hil move`, and 1 for a row that is none.
    """
    with contextlib.ExitStack() as undo:
        lines = undo.enter_context(file.open()) if file else sys.stdin
        mover = undo.enter_context(_moving("stream", rig, take))
        done = mover.stream(rows_of(lines), lead=lead)
        print(f"{done.sent} rows sent, {done.late} left out as too late")
        _say(mover, mover.wait())


def rows_of(lines: Iterable[str]) -> Iterator[Row]:
    """Rows of CSV text, each as soon as its line is there. Raises ValueError naming row and column."""
    header: list[str] = []
    try:
        for number, cells in enumerate(csv.reader(lines, skipinitialspace=True)):
            if header:
                yield _row(number, header, cells)
                continue
            header = [cell.strip() for cell in cells]
            if header[:1] != [TIME] or len(header) < 2:
                raise ValueError(f"the first line is {','.join(cells)[:60]!r}, expected {TIME},AXIS,...")
    except csv.Error as error:
        raise ValueError(f"no CSV: {error}") from None


def _row(number: int, header: list[str], cells: list[str]) -> Row:
    if len(cells) != len(header):
        raise ValueError(f"row {number}: {len(cells)} values, expected {len(header)} ({', '.join(header)})")
    time_s, *places = (_number(number, *cell) for cell in zip(header, cells, strict=True))
    return time_s, dict(zip(header[1:], places, strict=True))


def _number(row: int, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"row {row}, column {name}: {cell[:40]!r} is no finite number")
    return value


@contextlib.contextmanager
def _moving(command: str, rig: Path, take: bool) -> Iterator[Mover]:
    """The rig, ours to move. Ends the program as `told`."""
    with told(command), motion(config_of(rig).name, take=take, activate=False) as mover:
        yield mover


@contextlib.contextmanager
def told(command: str) -> Iterator[None]:
    """End the program, with the reason, where a rig is not ours to move or a goal is refused. SIGTERM is as Ctrl-C."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    except (GoalRefusedError, ValueError) as error:
        print(f"hil {command}: {error}", file=sys.stderr)
        raise typer.Exit(1) from None
    except (MotionError, NoGatewayError, RuntimeDirectoryError) as error:
        print(f"hil {command}: {error}", file=sys.stderr)
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    except KeyboardInterrupt:
        print(f"hil {command}: interrupted; the axes come to rest and hold", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None


def _say(mover: Mover, look: Look) -> None:
    print(f"in position: {', '.join(positions(mover.kinds, look.position))}")
