"""`hil sim`: one rig in lockstep, its figures as a table and as JSON."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress

from hil.cli.options import RigFile, shipped_scenario
from hil.cli.output import axis_table, drawable, print_plant_notes, writable, write_json
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError


def sim(
    rig: RigFile,
    seconds: Annotated[float, typer.Option(min=0.1, max=1e6, help="virtual time to run")] = 20.0,
    overrides: Annotated[list[str], typer.Option("--set", help="override a key of the rig file: key.path=value")] = [],  # noqa: B006
    json_target: Annotated[
        str, typer.Option("--json", callback=writable, help="write the report there; - for standard output")
    ] = "",
    faults: Annotated[
        Path | None,
        typer.Option(callback=shipped_scenario, help="faults to inject: a scenario file, or a shipped one's name"),
    ] = None,
    record: Annotated[Path | None, typer.Option(help="write a recording (MCAP) that `hil replay` takes")] = None,
    picture: Annotated[
        Path | None, typer.Option(callback=drawable, help="write a picture of the tracking, as .png, .svg, .pdf, ...")
    ] = None,
) -> None:
    """Run a rig in lockstep: the cycle against the emulated stage over a simulated wire, in exact virtual time."""
    from hil.rig.bus_load import refuse_unschedulable
    from hil.virtual.lockstep import simulate
    from hil.virtual.scenario import load_scenario

    config = load_rig(rig, overrides)
    refuse_unschedulable(config, rig.parent)  # most such runs never become ACTIVE, and cannot say why
    scenario = load_scenario(faults, config) if faults else None
    console = Console(stderr=json_target == "-")
    print_plant_notes(console, config)

    recorder = _recorder(record, config, rig)
    with Progress(console=console, transient=True) as bar:
        total = round(seconds * config.rate_hz)
        job = bar.add_task(f"{config.name}: {config.law.name}", total=total)
        try:
            report, traces = simulate(
                config,
                rig.parent,
                seconds,
                progress=lambda done: bar.update(job, completed=done),
                observer=recorder.observe if recorder else None,
                scenario=scenario,
            )
        except ValueError as error:  # a task or layout the rig cannot carry
            raise RigError([f"{rig}: {error}"]) from None
        finally:
            if recorder:
                recorder.close()
    report.overrides = list(overrides)
    _show(console, config, report, traces, picture)
    if json_target:
        write_json(dataclasses.asdict(report), json_target)


def _recorder(path: Path | None, config: RigConfig, rig: Path) -> Any:
    if path is None:
        return None
    from hil.telemetry.recorder import LockstepRecorder, RecordingError

    try:
        return LockstepRecorder(path, config, rig)
    except RecordingError as error:
        raise typer.BadParameter(str(error), param_hint="--record") from None


def _show(console: Console, config: RigConfig, report: Any, traces: Any, picture: Path | None) -> None:
    run = f"{report.rig}, {report.law}, {report.rate_hz:g} Hz, {report.ticks} ticks"
    title = f"{run}, steady from {report.steady_from_s:.3f} s"
    console.print(axis_table(config, report.axes, title))
    faults = ", ".join(f"{name} x{count}" for name, count in report.faults.items()) or "none"
    console.print(f"faults: {faults}; ended {report.state}; {report.realtime_factor:.1f} times real time")
    console.print(f"trace_sha256 {report.trace_sha256}", soft_wrap=True)
    if picture:
        from hil.cli.pictures import tracking_picture

        tracking_picture(picture, config, traces)
        console.print(f"picture {picture}")
