"""`hil ...`: every command is one function in a module of its own; only the one asked for is imported."""

import os
import sys
from typing import Annotated, NoReturn

import typer

from hil.cli.commands import Entry, add_commands, first_word, load
from hil.cli.failures import failure
from hil.cli.help_text import Overview, in_words, present_spelling
from hil.cli.streams import say
from hil.rig.control_path import control_path
from hil.rig.former_keys import show_former_keys

UNPARSED = {"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []}

COMMANDS: dict[str, dict[str, Entry]] = {
    "Start": {
        "demo": Entry("hil.operate.demo:demo", "Run an emulated stage, live on this computer, and watch it"),
        "sim": Entry("hil.virtual.commands:sim", "Run a rig in virtual time: the same result every time"),
        "rigs": Entry("hil.operate.rigs:rigs", "List the rig files that come with hil, and the rigs that run here"),
        "new": Entry("hil.operate.new:new", "Write a rig file for your own stage"),
        "check": Entry(
            "hil.studies.acceptance.command:check",
            "Check a rig: bus load, stability, margins; with --law, whether a law is fit to run",
        ),
        "explain": Entry("hil.operate.explain:explain", "Explain a key of the rig file: meaning, unit, range, default"),
        "doctor": Entry("hil.operate.doctor:doctor", "Check this computer: real-time rights, CAN, what to change"),
    },
    "Connect": {
        "drives": Entry("hil.operate.drives:drives", "Find and configure the drives of a rig, and jog one axis"),
        "bus": Entry("hil.operate.bus:bus", "Watch, record or play back a CAN bus"),
        "identify": Entry("hil.identify.command:identify", "Identify mass, friction and resonance of the axes"),
        "drive": Entry("hil.operate.drive:drive", "Emulate a CiA 402 drive from its EDS file"),
    },
    "Move": {
        "home": Entry("hil.operate.home:home", "Let a running rig find the positions of its axes"),
        "move": Entry("hil.operate.move:move", "Move axes of a running rig: hil move microscope x=1mm"),
        "jog": Entry("hil.operate.move:jog", "Move axes of a running rig at a speed for a time"),
        "stream": Entry("hil.operate.move:stream", "Move axes of a running rig through timed rows as they come"),
        "command": Entry(
            "hil.operate.command:command", "Activate, stop, reset or home a running rig, or change its task or law"
        ),
        "estop": Entry("hil.operate.estop:estop", "Stop a running rig at once; needs only its name"),
    },
    "Look": {
        "monitor": Entry("hil.operate.monitor:monitor", "Watch a running rig in the terminal"),
        "page": Entry("hil.page.command:page", "Watch and stop rigs from a browser or a phone"),
        "dashboard": Entry("hil.page.command:dashboard", "The former name of hil page"),
        "runs": Entry("hil.runs.listing:runs", "List the runs of a folder: rig, law, how each ended, accuracy, notes"),
        "baseline": Entry("hil.runs.baseline:baseline", "Keep what a sound run is like, to hold later runs against it"),
        "events": Entry("hil.runs.events:events", "List what happened in a running rig or in a recording"),
        "plot": Entry("hil.runs.views:plot", "Draw a run: set-point, following error, force"),
        "report": Entry("hil.runs.views:report", "Write a run as one HTML page"),
        "export": Entry("hil.runs.views:export", "Write a run's signals as CSV, NPZ or Parquet"),
        "diff": Entry("hil.runs.views:diff", "Compare two runs"),
        "share": Entry(
            "hil.runs.share:share", "Pack a run into one file for somebody else, without the source of laws"
        ),
    },
    "Test": {
        "accuracy": Entry("hil.operate.accuracy:accuracy", "Measure positioning accuracy by ISO 230-2"),
        "faults": Entry(
            "hil.studies.fault_campaign.command:faults", "Inject every fault in every state, and check the reaction"
        ),
        "replay": Entry("hil.virtual.replay_command:replay", "Run a recording's frames again and compare every torque"),
        "bench": Entry("hil.operate.bench.command:bench", "Measure this computer, or your CAN adapter and drives"),
    },
    "Study": {
        "inject": Entry("hil.studies.inject.command:inject", "Inject a batch of cells in virtual time, with verdicts"),
        "compare": Entry("hil.studies.compare.command:compare", "Compare control laws on one task"),
        "tune": Entry("hil.studies.tune.command:tune", "Search gains for a law and write them into the rig file"),
        "sweep": Entry("hil.studies.sweep.command:sweep", "Simulate thousands of stages with drawn parameters"),
        "evidence": Entry("hil.studies.evidence.command:evidence", "Print accuracies over drawn stages"),
        "learnt": Entry("hil.virtual.learnt:learnt", "Save what a learning law has learnt in a run"),
        "reproduce": Entry("hil.studies.paper.command:reproduce", "Check the paper's claims"),
    },
    "Serve": {
        "run": Entry("hil.cli.app:run_directly", "Run the control process of a rig", UNPARSED),
        "sidecar": Entry("hil.telemetry.sidecar:sidecar", "Publish and record a control process, take its commands"),
        "emulate": Entry("hil.virtual.commands:emulate", "Emulate the stage and its drives on the bus"),
        "camera": Entry("hil.camera.command:camera", "Find pipette and cell in a camera's images, and send readings"),
        "blackbox": Entry(
            "hil.telemetry.blackbox:blackbox", "Save the last ticks of a control process that was killed"
        ),
        "recover": Entry("hil.telemetry.recover:command", "Repair a recording that a crash cut short"),
        "install": Entry("hil.operate.install:install", "Install a rig file and its systemd units"),
        "uninstall": Entry("hil.operate.install:uninstall", "Remove what `hil install` installed"),
    },
}
OVERVIEW = """hil controls a cell-injection stage over CAN: it reads encoders, commands forces and records every tick.
Without hardware it controls an emulated stage.

Begin with:

\b
    hil demo              watch an emulated stage for 20 s
    hil new stage.toml    describe your own stage
    hil check stage.toml  check it before anything moves

`hil COMMAND --help` explains one command. RIG is a rig file, or the name of one that came
with hil or runs here (`hil rigs`)."""


def run_directly(context: typer.Context) -> None:
    """`hil run` parses its own arguments; hil/__main__.py starts it without coming here."""
    load("hil.live.run:main")(context.args)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # with all that reads e-mail: a quarter of what this module takes

        print(f"hil {version('hil')}, control path {control_path()}")
        raise typer.Exit


def _options(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Version, and how it was built")
    ] = False,
) -> None:
    pass


def build_app(wanted: str | None) -> typer.Typer:
    """The command line with `wanted` loaded and all others as lines of help.

    Help is plain text: rich cuts words off where a terminal is narrow, and takes as long to load as numpy.
    """
    app = typer.Typer(cls=Overview, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False)
    app.callback(help=OVERVIEW)(_options)
    for group, entries in COMMANDS.items():
        add_commands(app, entries, wanted, group)
    return app


def _words() -> list[str]:
    """The command line: this process' own, or the one a shell wants completed (zsh and fish, then bash)."""
    if "_HIL_COMPLETE" not in os.environ:
        return sys.argv
    return (os.environ.get("_TYPER_COMPLETE_ARGS") or os.environ.get("COMP_WORDS", "")).split()


def main() -> None:
    """The whole command line."""
    try:
        app = build_app(first_word(_words()[1:]))
    except (ImportError, OSError, MemoryError) as error:
        _leave(error)
    run(app)


def run(app: typer.Typer) -> None:
    """Run a command line of this project; what its user got wrong ends in a line of text and an exit status.

    78: the rig file, or an override of it; 69: no runtime directory, or files of this copy of hil are missing; 74: a
    file or folder that was named cannot be read or written.
    """
    show_former_keys()
    sys.argv[1:], told = present_spelling(sys.argv[1:])
    for line in told:
        print(f"hil: {line}", file=sys.stderr)
    try:
        in_words(typer.main.get_command(app))()
    except Exception as error:
        _leave(error)


def _leave(error: Exception) -> NoReturn:
    status, lines = failure(error)
    for line in lines:
        say(line)
    sys.exit(status)
