"""The command `hil identify`: what an axis is like, from experiments or from a recording."""

import datetime
import difflib
import hashlib
import shlex
import sys
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from hil.cli.exit_status import EXIT_FAULT, EXIT_FILE, EXIT_UNAVAILABLE
from hil.cli.options import JsonTarget, Overrides, ReadRig, named_axes
from hil.cli.output import drawable, write_json
from hil.identify.experiments import EXPERIMENTS
from hil.identify.findings import NOT_SEEN, Findings, from_run
from hil.identify.first_state import with_first_state
from hil.identify.lockstep import identify as run_experiments
from hil.identify.written import model_values, rig_text
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.runs.api import load_run
from hil.telemetry.blackbox import run_directory

if TYPE_CHECKING:
    from hil.operate.dead_man import Handle

EXIT_REFUSED = 4  # something was measured, and something was refused


def identify(
    rig: ReadRig,
    *,
    axes: Annotated[str, typer.Option(help="axes to identify, comma-separated; default: all")] = "",
    only: Annotated[
        str, typer.Option(help=f"experiments, comma-separated: {', '.join(EXPERIMENTS)}; default: all")
    ] = "",
    recording: Annotated[
        Path | None, typer.Option("--from", metavar="RUN", help="identify from this recording; nothing is run")
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="in real time on the rig; with bus.interface=local on an emulated stage")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(help="folder of the live recordings; named again, it continues an interrupted run [runs/<time>]"),
    ] = None,
    agreed: Annotated[
        bool, typer.Option("--yes", help="ask nothing before the rig moves, and move it without a held key")
    ] = False,
    keys: Annotated[
        Path | None,
        typer.Option(exists=True, dir_okay=False, help="--live: read held keys from this pipe", hidden=True),
    ] = None,
    write: Annotated[Path | None, typer.Option(help="new rig file with the identified model")] = None,
    accept: Annotated[
        str, typer.Option(metavar="NAMES", help="write although these were refused, comma-separated")
    ] = "",
    dry: Annotated[bool, typer.Option("--dry-run", help="show what --write would change; write nothing")] = False,
    picture: Annotated[
        Path | None,
        typer.Option(
            callback=drawable, help="draw frequency response, friction along the travel and over speed, loops"
        ),
    ] = None,
    responses: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="write AXIS.csv there: the frequency response, for hil check")
    ] = None,
    overrides: Overrides = None,
    json_target: JsonTarget = "",
) -> None:
    """Identify mass, friction, presliding, lag and resonance of each axis, with 95 % intervals.

    Without --from and --live, the experiments run in virtual time against the emulated stage. Exit status 3: one ended
    in a fault; 4: a value of the model was refused, and nothing is written; 69: a live one did not come to its end.
    """
    from hil.cli.console import plain_console
    from hil.identify.show import as_document, show

    config = load_rig(rig, overrides or ())
    if write and write.exists():
        raise typer.BadParameter(f"{write} exists; name a new file", param_hint="--write")
    if live and recording:
        raise typer.BadParameter("nothing moves with --from", param_hint="--live")
    if (out or agreed or keys) and not live:
        raise typer.BadParameter("of --live alone", param_hint="--out" if out else "--yes")
    names, experiments = named_axes(axes, config.axis_names), _experiments(only)
    console = plain_console(stderr=json_target == "-")
    handle = _handle(config, keys, agreed=agreed) if live else None
    folder = out or run_directory() if live else Path()
    again = shlex.join(["hil", *sys.argv[1:], *(["--out", str(folder)] if live and not out else [])])
    asked = _Asked(rig, config, names, experiments, console, again, write, dry)
    if live:
        findings, evidence = _found_live(asked, folder, handle, agreed=agreed)
    else:
        findings, evidence = _found(asked, recording)
    show(console, config, findings)
    if json_target:
        write_json(as_document(config, findings, evidence), json_target)
    if picture or responses:
        _report(asked, findings, picture, responses)
    refused = _refused(asked, findings, accept)
    evidence = f"hil {version('hil')}, {evidence}"
    if responses:
        evidence += f"; frequency responses in {responses}"
    told = _write(asked, findings, evidence, refused)
    if live:
        _tell_kept(asked, folder, findings)
    if any(one.ended for one in findings.values()):
        raise typer.Exit(EXIT_FAULT)
    if refused or (write and not told):
        raise typer.Exit(EXIT_REFUSED)


class _Asked(NamedTuple):
    """What is identified, and where it is told. file: of the rig; again: the command that was given; to: the new file;
    dry: only show what it would change.
    """

    file: Path
    config: RigConfig
    axes: list[str]
    experiments: list[str]
    console: Any
    again: str
    to: Path | None
    dry: bool

    def say(self, text: str) -> None:
        """A line."""
        self.console.print(text, markup=False, highlight=False, soft_wrap=True)


def _all_refused(findings: dict[str, Findings]) -> list[str]:
    return sorted({name for one in findings.values() for name in one.missing})


def _refused(asked: _Asked, findings: dict[str, Findings], accept: str) -> list[str]:
    """What was refused, and nobody accepts."""
    accepted = {name.strip() for name in accept.split(",") if name.strip()}
    refused = _all_refused(findings)
    for name in sorted(accepted.difference(refused, NOT_SEEN)):
        asked.say(f"--accept {name}: it was not refused")
    return [name for name in refused if name not in accepted]


def _write(asked: _Asked, findings: dict[str, Findings], evidence: str, refused: list[str]) -> bool:
    """The new rig file, or what it would change, and what to do next. False: no value of the model was found."""
    if not any(model_values(one.found) for one in findings.values()):
        what = f"{asked.to} is not written" if asked.to else "nothing to write"
        asked.say(f"{what}: no value of the model was found")
        return False
    found = {name: one.found for name, one in findings.items()}
    checked = {name: one.validation for name, one in findings.items() if one.validation}
    text = rig_text(asked.file, found, datetime.date.today().isoformat(), evidence, checked)
    if asked.dry:
        before, to = asked.file.read_text(encoding="utf-8"), str(asked.to or "NEW.toml")
        asked.say(
            "\n".join(
                difflib.unified_diff(before.splitlines(), text.splitlines(), str(asked.file), to, lineterm="", n=1)
            )
        )
    target = "" if asked.to else " --write NEW.toml"
    if refused:
        names = ",".join(_all_refused(findings))
        asked.say(f"refused: {', '.join(refused)}; nothing is written. To write the rest, and leave these as they are:")
        asked.say(f"  {asked.again}{target} --accept {names}")
    elif asked.dry or not asked.to:
        asked.say(f"next: {asked.again.replace(' --dry-run', '')}{target}")
    else:
        try:
            text, begins = with_first_state(text, asked.to, findings, asked.config)
            asked.to.write_text(text, encoding="utf-8")
        except OSError as error:
            asked.say(f"hil: {asked.to}: {error.strerror}")
            raise typer.Exit(EXIT_FILE) from None
        if begins:
            asked.say(begins)
        asked.say(f"written to {asked.to}; next: hil check {shlex.quote(str(asked.to))}")
    return True


def _tell_kept(asked: _Asked, out: Path, findings: dict[str, Findings]) -> None:
    """How to measure an experiment again whose recording was refused: the same command takes the kept one."""
    from hil.identify.live import kept_in

    kept = [
        str(kept_in(out, axis, experiment))
        for axis, one in findings.items()
        for experiment in asked.experiments
        if experiment in one.refused and not one.ended
    ]
    if kept:
        asked.say("the refused recordings are kept. To measure them again:")
        asked.say(f"  rm -r {shlex.join(kept)}\n  {asked.again}")


def _report(asked: _Asked, findings: dict[str, Findings], picture: Path | None, folder: Path | None) -> None:
    from hil.identify.report import identification_picture, write_responses  # matplotlib: half a second

    try:
        if picture:
            identification_picture(picture, findings, {name: axis.kind for name, axis in asked.config.axes.items()})
            asked.say(f"picture: {picture}")
        for name, path in (write_responses(folder, findings) if folder else {}).items():
            asked.say(f"{name}: frequency response in {path}; next: hil check {asked.file} --measured {name}={path}")
    except OSError as error:
        asked.say(f"hil: {picture or folder}: {error.strerror}")
        raise typer.Exit(EXIT_FILE) from None


def _found(asked: _Asked, recording: Path | None) -> tuple[dict[str, Findings], str]:
    """By axis, and the evidence in words."""
    if recording is None:
        found = run_experiments(asked.config, asked.file.parent, asked.axes, asked.say, asked.experiments)
        return found, f"in virtual time: {_traces(found)}"
    run = load_run(recording)
    if missing := [name for name in asked.axes if name not in run.axes]:
        raise RigError([f"{recording}: no axis {missing[0]}; it has {', '.join(run.axes)}"])
    file = recording / "run.mcap" if recording.is_dir() else recording
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    return {name: from_run(run, name) for name in asked.axes}, f"{file.name} sha256 {digest[:16]}"


def _handle(config: RigConfig, pipe: Path | None, *, agreed: bool) -> "Handle | None":
    """Of the key that has to be held; None where nobody has to hold one. Raises typer.BadParameter."""
    from hil.identify.live import is_emulated
    from hil.operate.dead_man import handle

    if pipe is None and (agreed or is_emulated(config)):
        return None
    if pipe is None and not sys.stdin.isatty():
        raise typer.BadParameter(
            "needs a terminal: the rig moves only while one of its keys is held (--yes: without)", param_hint="--live"
        )
    return partial(handle, pipe)


def _found_live(
    asked: _Asked, folder: Path, handle: "Handle | None", *, agreed: bool
) -> tuple[dict[str, Findings], str]:
    """By axis, from experiments in real time, and the evidence in words."""
    from hil.identify.live import LiveError, LiveExperiments, live_runtime  # the processes of a live run
    from hil.operate.demo_live import Signals

    def agrees(words: str) -> bool:
        asked.say(words)
        return agreed or typer.confirm("Does it move freely, and may it move now?")

    try:
        with live_runtime(asked.config) as runtime:
            runner = LiveExperiments(folder, asked.console, Signals(), agrees, runtime, handle)
            found = run_experiments(asked.config, asked.file.parent, asked.axes, asked.say, asked.experiments, runner)
    except LiveError as error:
        asked.say(f"hil: {error}\nto go on from there: {asked.again}")
        raise typer.Exit(EXIT_UNAVAILABLE) from None
    return found, f"in real time, {folder}: {_traces(found)}"


def _traces(found: dict[str, Findings]) -> str:
    """Hashes of the runs."""
    return ", ".join(
        f"{name} {what} {trace[:12]}" for name, one in found.items() for what, trace in one.evidence.items()
    )


def _experiments(only: str) -> list[str]:
    wanted = [name.strip() for name in only.split(",") if name.strip()] or list(EXPERIMENTS)
    if unknown := [name for name in wanted if name not in EXPERIMENTS]:
        raise typer.BadParameter(f"--only {unknown[0]}: the experiments are {', '.join(EXPERIMENTS)}")
    return wanted
