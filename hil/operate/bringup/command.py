"""`hil drives RIG`: the survey, and the jog of one axis, at a terminal."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, NoReturn

import typer

from drivers.bus.port import PortError
from drivers.config import BusConfig
from drivers.protocols.frame_text import Reader, layout_reader
from hil.cli.console import plain_console
from hil.cli.exit_status import EXIT_UNAVAILABLE
from hil.cli.output import write_json
from hil.live.stop_line import RigInUseError
from hil.operate.bringup.drive_host import DriveHost
from hil.operate.bringup.jog import NEGATIVE, POSITIVE, Jog, JogSettings, Unlatch, jog_settings
from hil.operate.bringup.report_text import as_document, show
from hil.operate.bringup.session import Bus, Session, open_rig_port, open_session
from hil.operate.bringup.survey import Survey, SurveyReport
from hil.operate.keys import NoTerminalError, held_keys
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.rig.segments import segment_rigs

_NOT_READY = 1  # exit status


class JogAsked(NamedTuple):
    """What the command line says of a jog. keys: a pipe to read held keys from instead of the terminal."""

    axis: str
    force: float | None
    speed: float | None
    distance: float | None
    keys: Path | None


def bring_up(
    path: Path,
    overrides: list[str],
    json_file: str | None,
    asked: JogAsked | None,
    open_bus: Callable[[BusConfig, DriveHost], Bus] = open_rig_port,
) -> None:
    """Survey, show, jog where asked for. Exit status 0: ready; 1: not ready; 69: no bus, or the rig is being run.

    Of a rig with several segments one after the other, to jog an axis the one that it is on.
    """
    rig = load_rig(path, overrides)
    parts = segment_rigs(rig)
    if asked:
        parts = [part for part in parts if asked.axis in part.axes] or [rig]
    documents: dict[str, object] = {}

    def tell(part: RigConfig, report: SurveyReport, reader: Reader) -> None:
        documents[part.bus.channel] = document = as_document(report, reader)
        if json_file and (json_file != "-" or len(documents) == len(parts)):
            write_json({"segments": documents} if rig.bus.segments else document, json_file)
        if json_file != "-":
            if rig.bus.segments:
                print(f"{part.bus.channel}: {', '.join(part.axis_names)}", flush=True)
            show(report, reader, plain_console(highlight=False))

    ready = [_bring_up(part, path, asked, tell, open_bus) for part in parts]
    if not all(ready):
        raise typer.Exit(_NOT_READY)


def _bring_up(
    rig: RigConfig,
    path: Path,
    asked: JogAsked | None,
    tell: Callable[[RigConfig, SurveyReport, Reader], None],
    open_bus: Callable[[BusConfig, DriveHost], Bus],
) -> bool:
    """The drives of one segment; whether they are ready."""
    try:
        settings = jog_settings(rig, asked.axis, asked.force, asked.speed, asked.distance) if asked else None
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    try:
        reader = _reader(rig, path.parent)
        if asked and settings:
            with held_keys(asked.keys) as keys, open_session(rig, path.parent, open_bus) as session:
                report = _survey(session, reader, tell)
                _jog(session, report, settings, keys)
        else:
            with open_session(rig, path.parent, open_bus) as session:
                report = _survey(session, reader, tell)
    except ValueError as error:
        raise RigError([f"{path}: {error}"]) from None
    except NoTerminalError as error:
        raise typer.BadParameter(str(error), param_hint="--jog") from None
    except (PortError, RigInUseError) as error:
        _fail(str(error))
    return report.ready


def _fail(text: str) -> NoReturn:
    print(f"hil drives: {text}", file=sys.stderr)
    raise typer.Exit(EXIT_UNAVAILABLE)


def _reader(rig: RigConfig, base_dir: Path) -> Reader:
    rated = [axis.rated_force for axis in rig.axes.values()]
    return layout_reader(rig.bus, rig.axis_names, rated, base_dir, rig.mountings)


def _survey(session: Session, reader: Reader, tell: Callable[[RigConfig, SurveyReport, Reader], None]) -> SurveyReport:
    survey = Survey(session.host)
    session.run(survey)
    report = survey.report()
    if session.stopped:
        _fail(f"stopped by {session.stopped}")
    tell(session.host.rig, report, reader)
    return report


def _jog(session: Session, report: SurveyReport, settings: JogSettings, keys: Callable[[], str]) -> None:
    """One jog. Nothing is printed while torque may be applied: a terminal that does not take it would hold the loop."""
    axis = report.axes[settings.axis]
    if report.intruder or axis.problem or axis.position is None:
        _fail(f"axis {axis.name} is not jogged: its drive is not ready")
    unit = "m" if session.host.rig.axes[axis.name].kind == "linear" else "rad"
    newton = "N" if unit == "m" else "N m"
    print(
        f"hold {POSITIVE} (positive) or {NEGATIVE} (negative): axis {axis.name}, at most {settings.force:g} {newton}, "
        f"{settings.speed:g} {unit}/s, {settings.distance:g} {unit}; any other key ends",
        flush=True,
    )
    jog = Jog(session.host, settings, keys)
    try:
        session.run(Unlatch(session.host, settings.axis))
        session.run(jog)
    finally:
        session.release()
    print(f"ended: {jog.ended or session.stopped}; moved {jog.moved:+.6g} {unit}, farthest {jog.farthest:.6g} {unit}")
    if not jog.was_enabled:
        print("the drive never said that it was enabled")
