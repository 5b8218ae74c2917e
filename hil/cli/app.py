"""`hil ...`: every command is one function in a module of its own; only the one asked for is imported."""

import os
import sys
from importlib.metadata import version
from typing import Annotated, NoReturn

import typer

from drivers.protocols.base import LayoutError
from drivers.runtime import RuntimeDirectoryError
from drivers.text_file import printable
from hil.cli.commands import Entry, add_commands, first_word, load
from hil.cli.exit_status import EXIT_CONFIG, EXIT_FILE, EXIT_UNAVAILABLE
from hil.rig.former_keys import show_former_keys
from hil.rig.provenance import control_path
from hil.rig.schema import RigError
from hil.rig.shipped import IncompleteError
from sim_plant.config import PlantError

UNPARSED = {"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []}

COMMANDS: dict[str, Entry] = {
    "demo": Entry(
        "hil.operate.demo:demo", "Emulated stage, control, telemetry and live view together, as real processes"
    ),
    "sim": Entry("hil.virtual.commands:sim", "Run a rig in lockstep: exact virtual time, the same bytes every time"),
    "check": Entry(
        "hil.studies.acceptance.command:check", "Does the traffic fit, is the loop stable; --law: may this law run?"
    ),
    "run": Entry("hil.cli.app:run_directly", "The control process", UNPARSED),
    "emulate": Entry("hil.virtual.commands:emulate", "The plant on the bus, when there is no stage"),
    "sidecar": Entry("hil.telemetry.sidecar:sidecar", "Publish, record and take commands for a control process"),
    "monitor": Entry("hil.operate.monitor:monitor", "Watch a rig in the terminal"),
    "events": Entry("hil.operate.events:events", "What happened: of a running rig, or of a recording"),
    "dashboard": Entry("hil.operate.dashboard:dashboard", "Watch a rig in a browser"),
    "command": Entry("hil.operate.command:command", "Activate, stop, reset or emergency-stop a running rig"),
    "new": Entry("hil.operate.new:new", "Write a rig file for a stage of your own"),
    "explain": Entry("hil.operate.explain:explain", "What a key of the rig file means: unit, range, default"),
    "estop": Entry(
        "hil.operate.estop:estop", "Stop a rig now, by its name alone: needs nothing but its control process"
    ),
    "doctor": Entry("hil.operate.doctor:doctor", "What this machine grants, and what to do about it"),
    "faults": Entry(
        "hil.studies.fault_campaign.command:faults", "Every fault in every state, phase and axis, in lockstep"
    ),
    "reproduce": Entry("hil.studies.paper.command:reproduce", "Check the paper's claims"),
    "compare": Entry("hil.studies.compare.command:compare", "All control laws on the same task"),
    "tune": Entry("hil.studies.tune.command:tune", "Find gains for a law and write them to the rig file"),
    "sweep": Entry("hil.studies.sweep.command:sweep", "Thousands of plants with seeded parameters"),
    "evidence": Entry("hil.studies.evidence.command:evidence", "Accuracies over drawn stages: median and 95 %"),
    "replay": Entry("hil.virtual.commands:replay", "Feed a recording to a new cycle and compare every torque frame"),
    "learnt": Entry("hil.virtual.learnt:learnt", "Keep what a run's law has learnt over its repeats"),
    "plot": Entry("hil.studies.run_views:plot", "Draw a run: setpoint, following error, force over time"),
    "report": Entry("hil.studies.run_views:report", "A run as one HTML file: figures, pictures, events, law, rig"),
    "export": Entry("hil.studies.run_views:export", "A run's columns as CSV, NPZ or Parquet"),
    "diff": Entry("hil.studies.run_views:diff", "What is otherwise in a second run"),
    "blackbox": Entry("hil.telemetry.blackbox:blackbox", "Save what a killed control process left behind"),
    "recover": Entry("hil.telemetry.recover:command", "Make a recording that a crash cut short whole again"),
    "drives": Entry("hil.operate.drives:drives", "Bring up the drives of a rig: who is there, and why not; jog"),
    "drive": Entry("hil.operate.drive:drive", "An emulated CiA 402 drive by its EDS, for anybody's master"),
    "bus": Entry("hil.operate.bus:bus", "Watch, record or play back a CAN bus"),
    "bench": Entry("hil.operate.bench.command:bench", "Measurements of this machine, against a reference"),
    "install": Entry("hil.operate.install:install", "Put the systemd units and a rig file in place"),
    "uninstall": Entry("hil.operate.install:uninstall", "Remove what `hil install` put in place"),
}


def run_directly(context: typer.Context) -> None:
    """`hil run` parses its own arguments; hil/__main__.py starts it without coming here."""
    load("hil.live.run:main")(context.args)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"hil {version('hil')}, control path {control_path()}")
        raise typer.Exit


def _options(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Version, and how it was built")
    ] = False,
) -> None:
    pass


def build_app(wanted: str | None) -> typer.Typer:
    """The command line with `wanted` loaded and all others as lines of help."""
    app = typer.Typer(no_args_is_help=True, add_completion=True, pretty_exceptions_enable=False, help=__doc__)
    app.callback(help=__doc__)(_options)
    add_commands(app, COMMANDS, wanted)
    return app


def _words() -> list[str]:
    """The command line: this process' own, or the one a shell wants completed (zsh and fish, then bash)."""
    if "_HIL_COMPLETE" not in os.environ:
        return sys.argv
    return (os.environ.get("_TYPER_COMPLETE_ARGS") or os.environ.get("COMP_WORDS", "")).split()


def main() -> None:
    """The whole command line."""
    run(build_app(first_word(_words()[1:])))


def run(app: typer.Typer) -> None:
    """Run a command line of this project; what its user got wrong ends in a line of text and an exit status.

    78: the rig file, or an override of it; 69: no runtime directory, or files of this copy of hil are missing; 74: a
    file or folder that was named cannot be read or written.
    """
    show_former_keys()
    try:
        app()
    except RigError as error:
        _fail(EXIT_CONFIG, *error.problems)
    except (PlantError, LayoutError) as error:
        _fail(EXIT_CONFIG, error)
    except (RuntimeDirectoryError, IncompleteError) as error:
        _fail(EXIT_UNAVAILABLE, error)
    except OSError as error:
        if error.filename is None:
            raise
        _fail(EXIT_FILE, f"{error.filename}: {error.strerror}")


def _fail(status: int, *problems: object) -> NoReturn:
    for problem in problems:
        print(printable(f"hil: {problem}"), file=sys.stderr)
    sys.exit(status)
