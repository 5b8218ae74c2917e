"""`hil drive EDS`: an emulated CiA 402 drive on a bus, by its EDS or DCF file: a test double for anybody's master."""

import sys
import time
from pathlib import Path
from typing import Annotated, Literal

import typer
from pydantic import ValidationError

from drivers.base.runtime import RuntimeDirectoryError
from drivers.bus.any_bus import joined
from drivers.bus.port import PortError, resolve_interface
from hil.cli.exit_status import EXIT_FILE, EXIT_UNAVAILABLE
from hil.operate.bus_options import BitrateOption, InterfaceOption, OptionsOption, invalid_words, stated_bus
from sim_plant.config import EmulatedDriveConfig
from sim_plant.drive_double import ORDERS, DoubleSettings, DriveDouble, make_drive
from sim_plant.drives.motion_drive import EMULATED, MotionDrive

Objects = list[str] | None


def _whole(text: str) -> int:
    """A number as people write it: 32768, 0x8000."""
    return int(str(text), 0)


def drive(
    eds: Annotated[
        Path, typer.Argument(metavar="EDS", exists=True, dir_okay=False, help="EDS or DCF file", show_default=False)
    ],
    node: Annotated[list[int], typer.Option(min=1, max=127, help="its number; several: as many drives")] = [1],  # noqa: B006
    channel: Annotated[str, typer.Option("--channel", "-c", help="such as can0")] = "can0",
    interface: InterfaceOption = "auto",
    bitrate: BitrateOption = 1_000_000,
    options: OptionsOption = None,
    *,
    rated_torque: Annotated[
        float | None,
        typer.Option(min=1e-6, max=1e6, help="of its motor, N m; what 6076h says [the file's 6076h, else 1]"),
    ] = None,
    counts: Annotated[int, typer.Option(min=1, max=2**31 - 1, help="of its encoder, per turn")] = 4096,
    inertia: Annotated[float, typer.Option(min=1e-12, max=1e6, help="of its motor, kg m^2")] = 1e-4,
    friction: Annotated[float, typer.Option(min=1e-12, max=1e6, help="viscous, N m s/rad")] = 1e-3,
    watchdog_s: Annotated[
        float, typer.Option(min=0, max=3600, help="FAULT when no new target came for so long; 0: never")
    ] = 0.0,
    boot_s: Annotated[float, typer.Option(min=0, max=3600, help="from power-on to its boot-up message")] = 0.0,
    missing: Annotated[Objects, typer.Option(help="object of the EDS that it has not: 1029h:01; several")] = None,
    aborts: Annotated[Objects, typer.Option(help="object whose every access it aborts; several")] = None,
    answer_delay_s: Annotated[float, typer.Option(min=0, max=10, help="of its SDO answers")] = 0.0,
    enable_delay_s: Annotated[float, typer.Option(min=0, max=10, help="from the command to OPERATION ENABLED")] = 0.0,
    answers: Annotated[
        Literal["expedited", "unsized", "segmented", "block"], typer.Option(help="how it answers SDO reads")
    ] = "expedited",
    status_bits: Annotated[
        int, typer.Option(parser=_whole, help="its own bits of the statusword, always set: 8, 14, 15, as 0x8000")
    ] = 0,
    dummy_mapping: Annotated[bool, typer.Option(help="RPDOs may map dummy objects, where the EDS says so")] = True,
    every: Annotated[bool, typer.Option("--every", help="say every service frame, heartbeats apart")] = False,
    orders: Annotated[
        bool, typer.Option("--orders", help=f"read lines from standard input: {', '.join(ORDERS)}")
    ] = False,
    seconds: Annotated[float | None, typer.Option(min=0, help="end after this time; otherwise at Ctrl-C")] = None,
) -> None:
    """Emulate a CiA 402 drive by its EDS until Ctrl-C: objects, SDO, PDOs, NMT, heartbeats, emergencies, states."""
    try:
        quirks = EmulatedDriveConfig(
            kind="cia402",
            missing=missing or [],
            aborts=aborts or [],
            answer_delay_s=answer_delay_s,
            enable_delay_s=enable_delay_s,
            answers=answers,
            status_bits=status_bits,
            dummy_mapping=dummy_mapping,
        )
    except ValidationError as error:
        raise typer.BadParameter(invalid_words(error)) from None
    bus = stated_bus(channel, interface, bitrate, options or [])
    if len(set(node)) != len(node):
        raise typer.BadParameter(f"nodes {node}: each needs a number of its own", param_hint="--node")
    settings = DoubleSettings(rated_torque, counts, inertia, friction, watchdog_s, boot_s, quirks)
    start_ns = time.monotonic_ns() + round(boot_s * 1e9)
    try:
        drives = [make_drive(eds, number, settings, start_ns) for number in node]
    except ValueError as error:
        print(f"hil drive: {error}", file=sys.stderr)
        raise typer.Exit(EXIT_FILE) from None
    try:
        with joined(bus, fd=False) as port:
            _introduce(eds, drives, f"{channel} ({resolve_interface(bus)})")
            double = DriveDouble(drives, port, _say, every=every, boot_s=boot_s)
            double.run(seconds, sys.stdin.fileno() if orders else None)
    except (PortError, RuntimeDirectoryError) as error:
        print(f"hil drive: {error}", file=sys.stderr)
        raise typer.Exit(EXIT_UNAVAILABLE) from None


def _introduce(eds: Path, drives: list[MotionDrive], where: str) -> None:
    modes = [name for mode, name in EMULATED.items() if drives[0].emulates(mode)]
    numbers = ", ".join(str(drive.node_id) for drive in drives)
    entries = len(drives[0].dictionary.entries)
    print(f"hil drive: {eds.name} as node {numbers} on {where}: {entries} objects, modes {', '.join(modes) or 'none'}")
    sys.stdout.flush()


def _say(text: str) -> None:
    print(f"{time.monotonic():.3f} {text}", flush=True)
