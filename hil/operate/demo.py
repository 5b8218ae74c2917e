"""`hil demo RIG`: a rig on an emulated stage, live where this computer keeps up, else in virtual time."""

import shlex
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from hil.cli.console import plain_console
from hil.cli.exit_status import EXIT_FAULT
from hil.cli.options import LawOfRun, Overrides, RigFile, with_law
from hil.cli.output import print_plant_notes, write_json
from hil.operate.demo_live import (
    ALWAYS,
    RECORDING,
    Demo,
    Interrupted,
    Scene,
    Signals,
    private_runtime,
)
from hil.operate.stalls import by_this_computer
from hil.rig.brought import code_of
from hil.rig.file import load_rig
from hil.telemetry.blackbox import run_directory
from hil.telemetry.recording import RecordingError

LIVE_RECORDING = "live.mcap"  # of a live run in whose place one in virtual time came
TASK_S = 20.0
LONGEST_S = 1e6
LOG_WIDTH = 120  # of tables where there is no terminal


def summed_up(scene: Scene, console: Console, clock: str) -> dict[str, Any] | None:
    """Read the recording back; write summary.json and tracking.png; print the tables. clock: live or virtual."""
    from hil.cli.pictures import tracking_picture  # matplotlib takes a second: not while the loop runs
    from hil.runs.summary import load_run, show, summarise

    try:
        run = load_run(scene.out / RECORDING)
    except RecordingError as error:
        console.print(f"no summary: {error}", soft_wrap=True)
        return None
    summary = {**summarise(run), "clock": clock}
    write_json(summary, str(scene.out / "summary.json"))
    late = run.lateness if clock == "live" else None
    tracking_picture(scene.out / "tracking.png", run.rig, run, late, run.marks)
    show(summary, run.rig, console)
    return summary


def this_command(program: str) -> str:
    """How this command was started, for a shell. program: sys.argv[0], which of `python -m hil` is a file of ours."""
    if Path(program).name == "__main__.py":
        return f"{shlex.quote(sys.executable)} -m hil"
    return shlex.quote(program)


def _what_next(scene: Scene, console: Console) -> None:
    rig, out = shlex.quote(str(scene.rig_file)), shlex.quote(str(scene.out))
    hil = "hil" if shutil.which("hil") else this_command(sys.argv[0])
    chosen = [text for text in scene.overrides if text not in ALWAYS]
    same = "".join(f" --set {shlex.quote(text)}" for text in chosen)
    stage = "".join(f" --set {shlex.quote(text)}" for text in chosen if not text.startswith("law."))
    runs_code = " --run-its-code" if code_of(scene.rig.model_dump(mode="json")) else ""
    other = "structured-kalman" if scene.rig.law.name == "pd-feedforward" else "pd-feedforward"
    console.print(
        f"in {out}/: summary.json, tracking.png, run.mcap\n"
        "next, try:\n"
        f"  {hil} replay {out}/run.mcap{runs_code}  # every torque frame again, byte for byte\n"
        f"  {hil} demo {rig} --law {other}{stage}\n"
        f"  {hil} sim {rig} --seconds 20{same}  # the same in exact virtual time\n"
        f"  {hil} doctor  # what this machine grants a real-time loop",
        soft_wrap=True,
        highlight=False,
        markup=False,
    )


def _in_virtual_time(scene: Scene, seconds: float, why: str, console: Console, check: Callable[[], None]) -> bool:
    """Run and record the rig in virtual time in place of the live run. Whether it came to its end."""
    from hil.operate.demo_virtual import run_virtual

    console.print(f"{why}. The same stage and law run in virtual time instead", soft_wrap=True, markup=False)
    target = scene.out / RECORDING
    if target.exists():
        target.replace(scene.out / LIVE_RECORDING)
    try:
        run_virtual(scene.rig, scene.rig_file, seconds, target, console, check)
    except Interrupted:
        return False
    return True


def demo(
    rig: RigFile,
    seconds: Annotated[
        float | None,
        typer.Option(
            min=0.5, max=LONGEST_S, help="how long the task runs [20; with --hold, until Ctrl-C]", show_default=False
        ),
    ] = None,
    hold: Annotated[
        bool,
        typer.Option("--hold", help="live, without a task: the stage holds where it stands, for hil move and hil jog"),
    ] = False,
    law: LawOfRun = "",
    overrides: Overrides = None,
    out: Annotated[Path | None, typer.Option(help="directory for what the run leaves [runs/<time>]")] = None,
    live: Annotated[
        bool | None,
        typer.Option(
            "--live/--virtual",
            help="run in real time, or in virtual time [real time, where this computer keeps up]",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Exit status 0: it went as planned, or in virtual time where this computer was too busy; 1: something failed, and
    the output says what; 3: it ended in a fault; 130 or 143: interrupted.
    """
    from hil.operate.demo_virtual import too_slow, was_too_busy

    if hold and live is False:
        raise typer.BadParameter("a stage in virtual time cannot be moved from outside", param_hint="--virtual")
    live = hold or live
    seconds = seconds or (LONGEST_S if hold else TASK_S)
    chosen = (*with_law(overrides, law), *ALWAYS)
    config = load_rig(rig, chosen)
    signals = Signals()
    console = plain_console(highlight=False)
    if not console.is_terminal:
        console.width = LOG_WIDTH
    scene = Scene(config, rig, chosen, private_runtime(), out or run_directory())
    scene.out.mkdir(parents=True, exist_ok=True)
    console.print(f"demo of {config.name}" + (f": {config.description}" if config.description else ""), soft_wrap=True)
    console.print(
        "the stage is emulated, the bus is local to this demo, and it runs even where no real time is granted",
        soft_wrap=True,
    )
    print_plant_notes(console, config)
    stage = Demo(scene, console, signals, insists=bool(live), holds=hold)
    summary = None
    why = "" if live else too_slow(config) if live is None else "Real time was not asked for"
    try:
        if not why:
            stage.run(seconds)
            why = stage.busy
            summary = None if why else summed_up(scene, console, "live")
            if live is None and summary and not stage.troubles:
                why = was_too_busy(summary)
        if why and not signals.seen and _in_virtual_time(scene, seconds, why, console, signals.check):
            summary = summed_up(scene, console, "virtual")
    finally:
        shutil.rmtree(scene.runtime, ignore_errors=True)
    if stage.stalls:
        console.print(f"{stage.stalls} stop(s) because this computer was too busy: shown, reset, activated again")
    _end(stage, summary, signals, console)
    _what_next(scene, console)


def _end(stage: Demo, summary: dict[str, Any] | None, signals: Signals, console: Console) -> None:
    """Exits with another status than 0, and says why, where something went wrong."""
    for trouble in stage.troubles:
        console.print(trouble, soft_wrap=True, markup=False)
    if signals.seen:
        sys.exit(128 + signals.seen)
    if summary and (latched := summary["latched"]):
        ours = by_this_computer(latched["name"].upper(), latched["cause"], latched["run_ns"], stage.events)
        if not ours or summary["clock"] == "virtual":
            sys.exit(EXIT_FAULT)
        console.print("this computer was too busy at the very end: the time was up before that stop was reset")
    if stage.troubles or summary is None:
        sys.exit(1)
