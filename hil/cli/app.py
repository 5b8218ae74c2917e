"""`hil …`: every command is one function in a module of its own; only the one asked for is imported."""

import importlib
import io
import sys
from collections.abc import Callable
from importlib.metadata import version
from typing import Annotated, Any, NamedTuple

import typer

from drivers.runtime import RuntimeDirectoryError
from hil.cli.exit_status import EXIT_CONFIG, EXIT_FILE, EXIT_UNAVAILABLE
from hil.rig.provenance import control_path
from hil.rig.schema import RigError
from sim_plant.config import PlantError


class Entry(NamedTuple):
    """Where a command lives, and its line in `hil --help`. `target` names a function, or a typer.Typer with sub-
    commands.
    """

    target: str
    help: str


COMMANDS: dict[str, Entry] = {
    "demo": Entry(
        "hil.operate.demo:demo", "Emulated stage, control, telemetry and live view together, as real processes"
    ),
    "sim": Entry("hil.virtual.sim:sim", "Run a rig in lockstep: exact virtual time, the same bytes every time"),
    "check": Entry("hil.operate.check:check", "Does the traffic fit the bus, and is the sampled loop stable?"),
    "run": Entry("hil.live.run:run", "The control process"),
    "emulate": Entry("hil.virtual.emulate:emulate", "The plant on the bus, when there is no stage"),
    "sidecar": Entry("hil.telemetry.sidecar:sidecar", "Publish, record and take commands for a control process"),
    "monitor": Entry("hil.operate.monitor:monitor", "Watch a rig in the terminal"),
    "dashboard": Entry("hil.operate.dashboard:dashboard", "Watch a rig in a browser"),
    "command": Entry("hil.operate.command:command", "Activate, stop, reset or emergency-stop a running rig"),
    "doctor": Entry("hil.operate.doctor:doctor", "What this machine grants, and what to do about it"),
    "faults": Entry(
        "hil.studies.fault_campaign.command:faults", "Every fault in every state, phase and axis, in lockstep"
    ),
    "reproduce": Entry("hil.studies.paper.reproduce:reproduce", "Check the paper's claims"),
    "compare": Entry("hil.studies.compare.command:compare", "All control laws on the same task"),
    "tune": Entry("hil.studies.tune.command:tune", "Find gains for a law and write them to the rig file"),
    "sweep": Entry("hil.studies.sweep:sweep", "Thousands of plants with seeded parameters"),
    "replay": Entry("hil.virtual.replay:replay", "Feed a recording to a new cycle and compare every torque frame"),
    "blackbox": Entry("hil.telemetry.blackbox:blackbox", "Save what a killed control process left behind"),
    "drives": Entry("hil.operate.drives:drives", "Can this CiA 402 drive be used, by its EDS, and if not, why not?"),
    "bus": Entry("hil.operate.bus:bus", "Watch, record or play back a CAN bus"),
    "bench": Entry("tests.benchmarks.command:bench", "Measurements, as ratios against a reference in the same run"),
    "install": Entry("hil.operate.install:install", "Put the systemd units and a rig file in place"),
    "uninstall": Entry("hil.operate.install:uninstall", "Remove what `hil install` put in place"),
}


def _load(target: str) -> Any:
    module, _, name = target.partition(":")
    return getattr(importlib.import_module(module), name)


def _not_loaded() -> None:
    raise AssertionError("only the command asked for is loaded")


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
    app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, help=__doc__)
    app.callback(help=__doc__)(_options)
    for name, entry in COMMANDS.items():
        command: Callable[..., Any] | typer.Typer = _load(entry.target) if name == wanted else _not_loaded
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name, help=entry.help)
        else:
            app.command(name, help=entry.help)(command)
    return app


def main() -> None:
    """The whole command line. Exit status 78 where the rig file, or an override of it, is at fault; 74 where
    a file or folder that was named cannot be read or written.
    """
    wanted = next((word for word in sys.argv[1:] if not word.startswith("-")), None)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that has no such letter gets a question mark
    try:
        build_app(wanted)()
    except RigError as error:
        for problem in error.problems:
            print(f"hil: {problem}", file=sys.stderr)
        sys.exit(EXIT_CONFIG)
    except PlantError as error:
        print(f"hil: {error}", file=sys.stderr)
        sys.exit(EXIT_CONFIG)
    except RuntimeDirectoryError as error:
        print(f"hil: {error}", file=sys.stderr)
        sys.exit(EXIT_UNAVAILABLE)
    except OSError as error:
        if error.filename is None:
            raise
        print(f"hil: {error.filename}: {error.strerror}", file=sys.stderr)
        sys.exit(EXIT_FILE)
