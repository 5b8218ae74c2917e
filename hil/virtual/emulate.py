"""`hil emulate RIG`: the emulated stage on the rig's bus, as a process of its own."""

import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from drivers.bus.port import PortError, open_port
from drivers.runtime import RuntimeDirectoryError
from hil.cli.exit_status import EXIT_UNAVAILABLE
from hil.live.runtime_paths import places
from hil.rig.file import load_rig
from hil.rig.plant import plant_notes
from hil.rig.schema import RigConfig, RigError
from hil.virtual.scenario import load_scenario
from sim_plant.emulator import EmulatedStage
from sim_plant.process import Emulator
from sim_plant.scenario.injector import Injector
from sim_plant.scenario.language import Scenario


def emulated_stage(rig: RigConfig, base_dir: Path, start_ns: int) -> EmulatedStage:
    """The rig's emulated stage. Raises RigError for a plant or layout that does not fit."""
    rated = [axis.rated_force for axis in rig.axes.values()]
    try:
        return EmulatedStage(rig.plant, rig.bus, rig.axis_names, rated, base_dir, start_ns, drives=rig.drives)
    except (ValueError, OSError) as error:
        raise RigError([f"rig {rig.name}: {error}"]) from None


def _live_scenario(path: Path, rig: RigConfig) -> Scenario:
    """A scenario that needs nobody to tell it what the control process is doing, nor a simulated wire."""
    scenario = load_scenario(path, rig)
    problems = [
        f"{path}: fault {number + 1}: a live emulator knows no wire, state or phase; use at_s or at_tick, or `hil sim`"
        for number, fault in enumerate(scenario.fault)
        if fault.on_wire or fault.at_state or fault.at_phase
    ]
    if problems:
        raise RigError(problems)
    return scenario


def emulate(
    rig: Annotated[Path, typer.Argument(help="rig file (TOML)", show_default=False)],
    overrides: Annotated[list[str] | None, typer.Option("--set", help="key.path=value, overrides the rig file")] = None,
    faults: Annotated[Path | None, typer.Option(help="scenario (TOML) with at_s and at_tick only")] = None,
    status: Annotated[Path | None, typer.Option(help="JSON status file; default: in the runtime directory")] = None,
) -> None:
    """Emulate the stage of RIG on its bus until SIGTERM, SIGINT or SIGHUP."""
    config = load_rig(rig, overrides or [])
    if status and not status.parent.is_dir():
        raise typer.BadParameter(f"{status.parent}: no such directory", param_hint="--status")
    scenario = _live_scenario(faults, config) if faults else None
    stage = emulated_stage(config, rig.parent, time.monotonic_ns())
    if scenario:
        Injector(scenario, stage, None, config.period_ns)
    try:
        port = open_port(config.bus, role="device", fd=stage.fd)
        target = status or places(config.name).emulator
    except (PortError, RuntimeDirectoryError) as error:
        print(f"hil emulate: {error}", file=sys.stderr)
        sys.exit(EXIT_UNAVAILABLE)
    emulator = Emulator(stage, port, target)
    for note in plant_notes(config):
        print(f"hil emulate: {note}", flush=True)
    print(f"hil emulate: {config.name} on {config.bus.channel}, status in {target}", flush=True)
    try:
        emulator.run()
    finally:
        port.close()
    if emulator.status_error:
        print(f"hil emulate: no status: {emulator.status_error}", file=sys.stderr)
    print(f"hil emulate: {stage.commands} commands answered", flush=True)
