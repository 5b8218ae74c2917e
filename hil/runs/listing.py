"""`hil runs`: the runs of a folder as a list, notes on them, their trend, and what they take on the disk."""

import contextlib
import errno
import fnmatch
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import typer

from drivers.base.text_file import printable
from hil.cli.exit_status import EXIT_FILE
from hil.cli.options import JsonTarget
from hil.cli.output import metres, write_json
from hil.cli.progress import Steps
from hil.cli.quantity import quantity
from hil.runs.facts import OUTCOMES
from hil.runs.kept import kept_run
from hil.runs.last import RUNS
from hil.runs.listed import ListedRun, Wanted, listed_runs
from hil.runs.note import Note, note_of, write_note
from hil.runs.trend import FEWEST, OVER, Trend, trends

SHOWN = 30
_HEADS = ("run", "rig", "law", "lasted", "ended", "worst RMS", "note")

runs = typer.Typer(invoke_without_command=True)

InFolder = Annotated[Path, typer.Option("--in", metavar="FOLDER", help="the folder of the runs")]
RigName = Annotated[str, typer.Option("--rig", metavar="NAME", help="of this rig; * and ? as in a shell")]
LawName = Annotated[str, typer.Option("--law", metavar="NAME", help="of this law; * and ? as in a shell")]
AxisName = Annotated[str, typer.Option("--axis", metavar="NAME", help="the axis that counts for accuracy")]
Labels = Annotated[list[str] | None, typer.Option("--label", metavar="LABEL", help="with this label; may be repeated")]


def _outcomes(asked: list[str] | None) -> list[str] | None:
    if unknown := [one for one in asked or () if one not in OUTCOMES]:
        raise typer.BadParameter(f"{unknown[0]}: expected one of {', '.join(OUTCOMES)}")
    return asked


@runs.callback()
def show(
    context: typer.Context,
    *,
    folder: InFolder = RUNS,
    rig: RigName = "*",
    law: LawName = "*",
    state: Annotated[
        list[str] | None, typer.Option(metavar="HOW", callback=_outcomes, help=f"how it ended: {', '.join(OUTCOMES)}")
    ] = None,
    label: Labels = None,
    axis: AxisName = "*",
    above: Annotated[str, typer.Option(metavar="LENGTH", help="steady RMS error above this, as 100nm")] = "",
    below: Annotated[str, typer.Option(metavar="LENGTH", help="steady RMS error below this, on all axes")] = "",
    last: Annotated[int | None, typer.Option(min=1, help=f"the newest of them [{SHOWN}]", show_default=False)] = None,
    json_target: JsonTarget = "",
) -> None:
    """List the runs of a folder."""
    if context.invoked_subcommand:
        return
    wanted = Wanted(
        rig, law, tuple(state or ()), tuple(label or ()), axis, _error("--above", above), _error("--below", below)
    )
    found = [run for run in read(folder) if wanted.has(run)]
    if json_target:
        write_json([run.document for run in (found[-last:] if last else found)], json_target)
        return
    shown = found[-(last or SHOWN) :]
    if shown:
        print("\n".join(_table(shown)))
    left_out = f"; the newest {len(shown)} are shown, --last {len(found)} shows all" if len(shown) < len(found) else ""
    print(f"{len(found)} {'run' if len(found) == 1 else 'runs'} in {printable(str(folder))}{left_out}")


@runs.command(short_help="Note something on a run, or label it")
def note(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="folder of a run, or its recording", show_default=False)],
    text: Annotated[str | None, typer.Argument(metavar="[TEXT]", help="the note; it replaces the old one")] = None,
    label: Annotated[list[str] | None, typer.Option(help="add a label; may be repeated")] = None,
    without: Annotated[list[str] | None, typer.Option(metavar="LABEL", help="take a label away")] = None,
) -> None:
    """Note something on a run, or label it; without TEXT and labels, show its note.

    The note is in a file beside the recording, run.note.json, and goes where the folder goes.
    """
    kept = kept_run(run)
    found = note_of(kept)
    if found.problem and text is None:
        print(f"hil: {printable(str(kept.folder))}: its note cannot be read: {found.problem}", file=sys.stderr)
        raise typer.Exit(EXIT_FILE)
    if text is None and not label and not without:
        print(_remark(found) or "no note")
        return
    labels = ({*found.labels} | {*(label or ())}) - {*(without or ())}
    try:
        path = write_note(kept, Note(found.text if text is None else text, tuple(labels)))
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    print(printable(str(path)))


@runs.command(short_help="Tell axes whose error drifts over runs")
def trend(
    *,
    folder: InFolder = RUNS,
    rig: RigName = "*",
    law: LawName = "*",
    axis: AxisName = "*",
    over: Annotated[int, typer.Option(min=FEWEST, max=1000, help="the newest runs of a rig that count")] = OVER,
    json_target: JsonTarget = "",
) -> None:
    """Tell axes whose steady RMS error drifts over runs of the same rig.

    The rule: the median slope between all pairs of runs makes 5 % or more, and the order of the runs is one that chance
    gives once in 1000 (Theil-Sen, Mann-Kendall). Runs that ended in a stop or lack ticks do not count.

    Exit status 1: an axis drifts.
    """
    wanted = Wanted(rig, law)
    found = [one for one in trends(filter(wanted.has, read(folder)), over) if fnmatch.fnmatchcase(one.axis, axis)]
    if json_target:
        write_json([one.document for one in found], json_target)
    else:
        print("\n".join(map(_trend_line, found)) or "no axis with three sound runs of one rig")
    if any(one.drifts for one in found):
        raise typer.Exit(1)


@runs.command(short_help="Tell what the runs take on the disk")
def disk(folder: InFolder = RUNS, json_target: JsonTarget = "") -> None:
    """Tell what the runs take on the disk, with snapshots of faults, and how much of the quota that is.

    Exit status 1: recordings, snapshots and black boxes take more than telemetry.record_quota.
    """
    from hil.runs.disk import disk_use

    found = disk_use(folder, read(folder))
    quota, kept = found["quota"], found["kept"]
    if json_target:
        write_json(found, json_target)
    else:
        for kind, row in found["kinds"].items():
            print(f"{kind:15}  {row['files']:6} files  {row['bytes'] / 1e6:12.3f} MB")
        whose = f"the newest run's rig, {_one_line(found['quota_of'])}" if found["quota_of"] else "the default"
        share = f"{kept / quota:.1%} of the quota of {quota / 1e6:.0f} MB"
        print(f"recordings, snapshots and black boxes take {share} (telemetry.record_quota of {whose})")
        if kept > quota:
            print("the oldest go when the next recording begins; of snapshots only what is beyond half of the quota")
    if kept > quota:
        raise typer.Exit(1)


def _trend_line(found: Trend) -> str:
    before, after = metres(found.before, found.kind), metres(found.after, found.kind)
    verdict = "DRIFT" if found.drifts else "too few runs" if found.runs < FEWEST else "no drift"
    whose = f"{found.rig}, {found.law}, {found.clock}, rig hash {found.rig_hash[:8]}"
    line = f"{verdict}: {found.axis} RMS {before} to {after}, {found.change:+.1%} over {found.runs} runs of {whose}"
    return _one_line(line)


def read(folder: Path) -> list[ListedRun]:
    """All runs of a folder; how far the reading of new ones is, on standard error. Raises OSError."""
    if folder == RUNS and not folder.exists():
        raise FileNotFoundError(errno.ENOENT, "no run here; make one: hil demo", f"{RUNS}/")
    with _reading() as began:
        return listed_runs(folder, began)


@contextlib.contextmanager
def _reading() -> Iterator[Callable[[int], Callable[[], None]]]:
    with contextlib.ExitStack() as stack:

        def began(total: int) -> Callable[[], None]:
            return stack.enter_context(Steps("reading runs that are new", total)).advance

        yield began


def _error(option: str, text: str) -> tuple[str, float] | None:
    """(kind of axis, m or rad) of a length or an angle. Raises typer.BadParameter."""
    if not text:
        return None
    for kind in ("linear", "rotary"):
        with contextlib.suppress(ValueError):
            return kind, quantity(option, text, kind)
    raise typer.BadParameter(f"{text}: expected a length or an angle, such as 100nm or 2urad", param_hint=option)


def _table(found: list[ListedRun]) -> Iterator[str]:
    """Lines of a list, in columns; a thousand of them cost milliseconds."""
    rows = [_HEADS, *(_row(run) for run in found)]
    widths = [max(len(row[column]) for row in rows if len(row) > 2) for column in range(len(_HEADS) - 1)]
    widths[0] = max(len(row[0]) for row in rows)
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None  # a file or a pipe has none
    for row in rows:
        cells = [cell.ljust(size) for cell, size in zip(row, widths, strict=False)]
        line = "  ".join([*cells, *row[len(cells) :]]) if len(row) > 2 else f"{row[0].ljust(widths[0])}  {row[1]}"
        yield line.rstrip()[:width]


def _row(run: ListedRun) -> tuple[str, ...]:
    facts = run.facts
    name = _one_line(run.kept.folder.name if run.kept.path == run.kept.folder else _of_file(run))
    if facts["outcome"] == "unread":
        return name, _one_line(f"not read: {facts['problem']}{_said(run)}")
    axis, error, kind = run.worst
    accuracy = f"{axis} {metres(error, kind)}" if axis else "-"
    remark = ", ".join(part for part in (run.lacks, _remark(run.note)) if part)
    cells = (name, facts["rig"], facts["law"], f"{facts['seconds']:.1f} s", run.ended, accuracy, remark)
    return tuple(map(_one_line, cells))


def _of_file(run: ListedRun) -> str:
    return f"{run.kept.folder.name}/{run.kept.first.name}"


def _said(run: ListedRun) -> str:
    remark = _remark(run.note)
    return f"; {remark}" if remark else ""


def _remark(note: Note) -> str:
    if note.problem:
        return f"its note cannot be read: {note.problem}"
    return " ".join([*(f"[{label}]" for label in note.labels), note.text]).strip()


def _one_line(text: str) -> str:
    return printable(text).replace("\n", " ")
