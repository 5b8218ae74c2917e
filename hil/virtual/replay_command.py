"""`hil replay`: arguments in, text and exit status out; and what it takes to run code that a recording carries."""

import io
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from rich.console import Console
from rich.markup import escape

from drivers.base.text_file import printable
from hil.cli.console import plain_console
from hil.cli.exit_status import EXIT_FAULT
from hil.cli.options import JsonTarget, Overrides
from hil.cli.output import write_json
from hil.rig.carried_code import Code, carried_code, trust, trusted
from hil.rig.provenance import rig_of_run
from hil.telemetry.recording import Recording, RecordingError, first_part
from hil.virtual.report_text import report_document, show_latched
from hil.virtual.sandbox import ConfinedError, confined


class _Outcome(NamedTuple):
    """What a replay comes to, as JSON carries it."""

    text: str
    document: dict[str, Any]
    status: int


def _show_replay(report: Any, console: Console, recording: Path) -> None:
    verdict = "every torque frame is the same" if not report.different else f"{report.different} ticks differ"
    if not report.frames:
        begins = f"it begins in the middle of a run{_where_it_begins(recording)}"
        why = begins if report.gap_at == 0 else "it holds no frame that was sent"
        verdict = f"nothing was compared, as {why}"
    files = f" of {report.parts} files" if report.parts > 1 else ""
    console.print(f"{report.rig}: {report.ticks} ticks, {report.frames} frames{files} replayed; {verdict}")
    show_latched(report, console)
    if report.first_different is not None:
        console.print(f"the first tick that differs is {report.first_different}")
        if report.other_version:
            console.print(report.other_version)
    if report.gap_at is not None:
        console.print(
            f"ticks are missing from the recording after tick {report.gap_at}: replayed up to there; "
            f"{report.not_compared} recorded ticks behind the gap are not compared"
        )
    if report.loss:
        console.print(report.loss)
    for name, row in (report.other_force or {}).items():
        console.print(f"  {report.other_law} would differ on {name} by {row['rms']:.3g} RMS, {row['max']:.3g} at most")


def replay(
    recording: Annotated[Path, typer.Argument(help="run.mcap of a live or lockstep run", show_default=False)],
    law: Annotated[str, typer.Option(help="also show what this law would have asked for")] = "",
    overrides: Overrides = None,
    json_target: JsonTarget = "",
    run_its_code: Annotated[
        bool,
        typer.Option("--run-its-code", help="run code that the recording carries, confined"),
    ] = False,
    trust_its_code: Annotated[
        bool, typer.Option("--trust-its-code", help="the same, and from now on without being asked")
    ] = False,
) -> None:
    """Run a recording's frames through a new control cycle, and compare every byte it would have sent.

    Exit status 0: every byte is the same; 1: some differ, nothing was compared, or ticks are missing; 3: the run ended
    in a fault.
    """
    changes = (*([f"law.name={json.dumps(law)}"] if law else []), *(overrides or ()))
    if (first := first_part(recording)) != recording and first.exists():
        print(printable(f"hil replay: a later part: replays the whole run, from {first} on"), file=sys.stderr)
        recording = first
    try:
        with rig_of_run(Recording(recording).metadata) as (rig, _):
            code = carried_code(rig)
        _allow(recording, code, run=run_its_code, keep=trust_its_code)
        found = _confined(recording, changes, code) if code else _replayed(recording, changes, (), lambda: None)
    except (RecordingError, ConfinedError) as error:
        print(f"hil replay: {error}", file=sys.stderr)
        raise typer.Exit(1) from None
    plain_console(stderr=json_target == "-").print(found.text, markup=False, soft_wrap=True, end="")
    if json_target:
        write_json(found.document, json_target)
    if found.status:
        raise typer.Exit(found.status)


def _where_it_begins(recording: Path) -> str:
    """Which file a later part of a recording lacks; empty of a first part."""
    first = first_part(recording)
    if first == recording:
        return ""
    name = escape(printable(first.name))
    return f"; a replay needs its first part, {name}, in the same folder, and all parts between"


def _allow(recording: Path, code: list[Code], *, run: bool, keep: bool) -> None:
    """Say what will run. Raises RecordingError where nobody has allowed it."""
    known = trusted()
    unknown = [part for part in code if part.digest not in known]
    if unknown and not (run or keep):
        what = "; ".join(part.text for part in unknown)
        raise RecordingError(
            f"{recording}: {what}: code that came with the recording, and is not run unasked. To run it in a process "
            f"that can neither write nor reach the network: hil replay {recording} --run-its-code"
        )
    for part in code:
        print(f"hil replay: runs {part.text} of the recording; it cannot write or reach the network", file=sys.stderr)
    if keep and unknown:
        try:
            print(f"hil replay: trusted from now on: {trust(unknown)}", file=sys.stderr)
        except OSError as error:
            raise RecordingError(f"{error.filename}: {error.strerror}") from None


def _replayed(
    recording: Path, changes: tuple[str, ...], permitted: tuple[str, ...], prepare: Callable[[], None]
) -> _Outcome:
    from hil.virtual.replay import replay_run

    report = replay_run(recording, changes, permitted, prepare)
    text = io.StringIO()
    _show_replay(report, plain_console(file=text, soft_wrap=True), recording)
    incomplete = report.different or not report.frames or report.loss
    status = 1 if incomplete else EXIT_FAULT if report.latched else 0
    return _Outcome(text.getvalue(), report_document(report), status)


def _confined(recording: Path, changes: tuple[str, ...], code: list[Code]) -> _Outcome:
    import hil.virtual.replay  # noqa: F401 (numpy and its threads are there before the filter)

    permitted = tuple(part.digest for part in code)
    text, document, status = confined(lambda confine: _replayed(recording, changes, permitted, confine))
    if not (isinstance(text, str) and isinstance(document, dict) and status in (0, 1, EXIT_FAULT)):
        raise ConfinedError("the code that it carries gave no answer of a replay")
    return _Outcome(printable(text), document, status)
