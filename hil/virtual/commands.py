"""The commands `hil sim` and `hil emulate`: arguments in, text and exit status out."""

import contextlib
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress

from hil.analysis.figures_of_merit import NOT_SETTLED
from hil.cli.console import plain_console
from hil.cli.exit_status import EXIT_FAULT
from hil.cli.options import JsonTarget, LawOfRun, Overrides, ReadRig, RigFile, shipped_scenario, with_law
from hil.cli.output import axis_table, drawable, print_plant_notes, write_json
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.virtual.report_text import report_document, show_latched

_TOO_SLOW = (
    "hil emulate: the emulated stage takes all of a core and comes behind: its answers are late, and the rig sees "
    "drives that do not answer. Compile it (make compiled, the Debian package), take a lighter stage (--set "
    "plant.stage=ideal) or a lower rate"
)


def sim(
    rig: ReadRig,
    seconds: Annotated[float, typer.Option(min=0.1, max=1e6, help="virtual time to run")] = 20.0,
    overrides: Overrides = [],  # noqa: B006
    json_target: JsonTarget = "",
    faults: Annotated[
        Path | None,
        typer.Option(callback=shipped_scenario, help="faults to inject: a scenario file, or a shipped one's name"),
    ] = None,
    record: Annotated[Path | None, typer.Option(help="write a recording (MCAP) that `hil replay` takes")] = None,
    picture: Annotated[
        Path | None, typer.Option(callback=drawable, help="write a picture of the tracking, as .png, .svg, .pdf, ...")
    ] = None,
    *,
    law: LawOfRun = "",
    keep: Annotated[
        bool | None,
        typer.Option(
            "--keep/--no-keep",
            help="keep recording and picture in runs/<time>, or nothing  [the recording, without --record]",
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="keep recording and picture in this folder")] = None,
) -> None:
    """The control cycle runs against the emulated stage over a simulated wire, in exact virtual time.

    Exit status 3: the run ended in a fault.
    """
    from hil.analysis.feasibility import task_problems
    from hil.analysis.task_figures import excursion_notes, excursion_problems
    from hil.control.estimator.gains import per_axis
    from hil.rig.baseline_file import read_baseline
    from hil.rig.bus_load import refuse_unschedulable
    from hil.rig.encoder_range import encoder_range_problems
    from hil.telemetry.run_recorder import prune
    from hil.virtual.scenario import load_scenario
    from hil.virtual.sim import simulate

    overrides = with_law(overrides, law)
    config = load_rig(rig, overrides)
    layout = refuse_unschedulable(config, rig.parent)  # most such runs never become ACTIVE, and cannot say why
    start = per_axis(config.plant.initial_position, len(config.axes)).tolist()
    try:
        infeasible = [*encoder_range_problems(config, layout), *task_problems(config, start)]
        infeasible += excursion_problems(config)
    except ValueError as error:  # a task that cannot be planned
        raise RigError([f"{rig}: {error}"]) from None
    if infeasible:
        raise RigError([f"{rig}: {problem}" for problem in infeasible])
    scenario = load_scenario(faults, config) if faults else None
    console = plain_console(stderr=json_target == "-")
    print_plant_notes(console, config)
    for note in excursion_notes(config):
        console.print(note, soft_wrap=True, markup=False)

    folder = _run_folder(out, keep, console) if keep or out or (keep is None and record is None) else None
    if folder is not None:
        record = record or folder / "run.mcap"
        picture = picture or (folder / "tracking.png" if keep or out else None)
    baseline = read_baseline(config)
    recorder = _recorder(record, config, rig, baseline)
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
                tell=recorder.tell if recorder else None,
                baseline=baseline,
            )
        except ValueError as error:  # a task or layout the rig cannot carry
            raise RigError([f"{rig}: {error}"]) from None
        finally:
            if recorder:
                recorder.close()
    if folder is not None and out is None:
        prune(folder.parent, config.telemetry.record_quota, folder / "run.mcap")
    report.overrides = overrides
    _show(console, config, report, traces, picture)
    if folder is not None:
        console.print(f"kept in {folder}/", soft_wrap=True, markup=False, highlight=False)
    if json_target:
        write_json(report_document(report), json_target)
    if report.latched:
        raise typer.Exit(EXIT_FAULT)


def _run_folder(asked: Path | None, keep: bool | None, console: Console) -> Path | None:
    """The folder that was asked for, which holds no run yet, or a new one; None where nobody asked, and none can be
    made here. Raises typer.BadParameter, OSError.
    """
    from hil.telemetry.blackbox import run_directory

    if asked is None:
        try:
            return run_directory()
        except OSError as error:
            if keep:
                raise
            why = f"not kept: {error.filename}: {error.strerror}; --out FOLDER keeps a run elsewhere"
            console.print(why, soft_wrap=True, markup=False, highlight=False)
            return None
    asked.mkdir(parents=True, exist_ok=True)
    if (asked / "run.mcap").exists():
        raise typer.BadParameter(f"{asked}: it holds a run already", param_hint="--out")
    return asked


def _recorder(path: Path | None, config: RigConfig, rig: Path, baseline: dict[str, Any] | None) -> Any:
    if path is None:
        return None
    from hil.telemetry.recorder import LockstepRecorder

    return LockstepRecorder(path, config, rig, baseline)


def _show(console: Console, config: RigConfig, report: Any, traces: Any, picture: Path | None) -> None:
    run = f"{report.rig}, {report.law}, {report.rate_hz:g} Hz, {report.ticks} ticks"
    begins = f"from {report.steady_from_s:.3f} s"
    title = f"{run}, steady {begins}" if report.settled else f"{run}, {begins}; {NOT_SETTLED}"
    console.print(axis_table(config, report.axes, title))
    faults = ", ".join(f"{name} x{count}" for name, count in report.faults.items()) or "none"
    console.print(f"faults: {faults}; ended {report.state}; {report.realtime_factor:.1f} times real time")
    show_latched(report, console)
    if report.law_failure:
        console.print(report.law_failure, style="red", markup=False, soft_wrap=True)
    if picture:
        import numpy as np

        from hil.cli.pictures import tracking_picture
        from hil.events.marks import marks_of

        tracking_picture(picture, config, traces, marks=marks_of(report.events, np.arange(report.ticks)))
        console.print(f"picture {picture}")
    console.print(f"trace_sha256 {report.trace_sha256}", soft_wrap=True)


def emulate(
    rig: RigFile,
    overrides: Overrides = None,
    faults: Annotated[Path | None, typer.Option(help="scenario (TOML) with at_s and at_tick only")] = None,
    status: Annotated[Path | None, typer.Option(help="JSON status file; default: in the runtime directory")] = None,
    *,
    camera: Annotated[
        bool, typer.Option("--camera", help="leave the sensors of [camera] to `hil camera RIG --source drawn`")
    ] = False,
) -> None:
    """Emulate the stage of RIG on its bus until SIGTERM, SIGINT or SIGHUP."""
    from drivers.base.runtime import RuntimeDirectoryError
    from drivers.bus.port import PortError
    from drivers.bus.segmented_port import open_segments
    from hil.cli.exit_status import EXIT_UNAVAILABLE
    from hil.live.runtime_paths import AlreadyServedError, runtime_paths, sole
    from hil.rig.plant_notes import plant_notes
    from hil.virtual.emulate import emulated_stage, live_scenario, scene_shown, without_camera
    from sim_plant.process import Emulator
    from sim_plant.scenario.injector import Injector

    config = load_rig(rig, overrides or [])
    if status and not status.parent.is_dir():
        raise typer.BadParameter(f"{status.parent}: no such directory", param_hint="--status")
    scenario = live_scenario(faults, config) if faults else None
    stage = emulated_stage(without_camera(config) if camera else config, rig.parent, time.monotonic_ns())
    if scenario:
        Injector(scenario, stage, None, config.period_ns)
    with contextlib.ExitStack() as stack:
        try:
            files = runtime_paths(config.name)
            stack.enter_context(sole(files, "emulator"))  # two would answer every command twice
            port = open_segments(config.bus, role="device", fd=stage.fd)
        except (PortError, RuntimeDirectoryError, AlreadyServedError) as error:
            print(f"hil emulate: {error}", file=sys.stderr)
            sys.exit(EXIT_UNAVAILABLE)
        stack.callback(port.close)
        for note in plant_notes(config):
            print(f"hil emulate: {note}", flush=True)
        watched = stack.enter_context(scene_shown(config, stage, files.scene)) if camera else lambda: None
        emulator = Emulator(
            stage, port, status or files.emulator, lambda: print(_TOO_SLOW, file=sys.stderr, flush=True), watched
        )
        print(
            f"hil emulate: {config.name} on {', '.join(config.bus.channels)}, status in {status or files.emulator}",
            flush=True,
        )
        emulator.run()
    if emulator.status_error:
        print(f"hil emulate: no status: {emulator.status_error}", file=sys.stderr)
    print(f"hil emulate: {stage.commands} commands answered", flush=True)
