"""`hil inject`: a batch of cells, in virtual time, live on the emulated stage, or of a rig that runs."""

import re
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from rich.console import Console

from drivers.base.named_file import write_text
from drivers.protocols.base import HostProtocol
from hil.cli.console import plain_console
from hil.cli.options import JsonTarget, Overrides, ReadRig
from hil.cli.output import writable, write_json
from hil.cli.progress import Steps
from hil.control.motion.contract import Request
from hil.control.motion.injection.settings import Settings
from hil.control.motion.injection.z_laws import Z_LAWS
from hil.operate.check_sensor import check_sensor
from hil.rig.bus_load import refuse_unschedulable, rig_layout
from hil.rig.file import load_rig
from hil.rig.schema import RigConfig, RigError
from hil.studies.inject.batch import Batch, Follower, Injected
from hil.studies.inject.batch import inject as inject_batch
from hil.studies.inject.equipment import (
    MOST_CELLS,
    Positions,
    assumed,
    check_within,
    grid,
    middle,
    read_angles,
    read_positions,
    words,
)  # fmt: skip
from hil.studies.inject.judge import Line, judged
from hil.studies.inject.requests import WORDS, Declared, Script, declared
from hil.studies.inject.sheet import Sheet, read_sheet
from hil.studies.inject.shown import Shown, document, show


class Plan(NamedTuple):
    """What is injected. words: overrides of the rig file. done: cells that are over already."""

    rig: RigConfig
    rig_file: Path
    words: tuple[str, ...]
    layout: HostProtocol
    places: Positions
    done: list[Injected]
    assumed: str


def inject(
    rig_file: ReadRig,
    *,
    cells: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="CSV file with x and y of each cell, m")
    ] = None,
    turn: Annotated[
        str,
        typer.Option(metavar="AXIS", help="rotary axis that turns the holder: --cells has its angle at each cell, rad"),
    ] = "",
    grid_text: Annotated[str, typer.Option("--grid", metavar="RxC", help="rows and columns of cells")] = "4x5",
    pitch: Annotated[float, typer.Option(min=1e-5, max=0.1, help="distance between the cells of a grid, m")] = 1e-3,
    anomalies: Annotated[float, typer.Option(min=0.0, max=1.0, help="share of abnormal cells")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="of the emulated dish")] = 1,
    z_law: Annotated[
        str, typer.Option("--z-law", metavar="NAME", help=f"how the tip goes in: {', '.join(Z_LAWS)}")
    ] = "",
    speed: Annotated[
        float,
        typer.Option(min=0.0, max=0.05, help="speed of search and press, m/s; 0: as the rig or the equipment has it"),
    ] = 0.0,
    compare: Annotated[
        bool, typer.Option("--compare", help="inject the same cells by every --z-law, in virtual time; one table")
    ] = False,
    live: Annotated[bool, typer.Option("--live", help="in real time on an emulated stage, as hil demo")] = False,
    attach: Annotated[bool, typer.Option("--attach", help="follow the batch of a running rig")] = False,
    ask: Annotated[
        list[str] | None,
        typer.Option(metavar="WORD@CELL:PHASE", help="pause, skip or abort there, as skip@3 or pause@2:press; repeat"),
    ] = None,
    tell: Annotated[
        str, typer.Option(metavar="WORD", help="ask a running batch to pause, resume, skip or abort, and end")
    ] = "",
    judge: Annotated[
        bool, typer.Option("--judge", help="compare with the required figures; exit status 1 where one is missed")
    ] = False,
    specification: Annotated[
        bool, typer.Option("--specification", help="run a batch for each required figure, in virtual time; one table")
    ] = False,
    csv_target: Annotated[
        str, typer.Option("--csv", metavar="PATH", callback=writable, help="write a line for each cell, as it goes on")
    ] = "",
    resume: Annotated[bool, typer.Option("--resume", help="continue where the file of --csv ends")] = False,
    report_target: Annotated[
        str, typer.Option("--report", metavar="PATH", callback=writable, help="write the batch as one HTML page")
    ] = "",
    json_target: JsonTarget = "",
    overrides: Overrides = None,
) -> None:
    """Inject a batch of cells: approach, touch, puncture, pulse, and a verdict for each cell.

    In virtual time, and with --live, nothing real moves. A rig whose [motion] is not "cells" gets reference equipment
    for the time of the run: a force sensor, a camera, a valve and a dish of cells, all of them assumed. At a terminal a
    live batch is asked by keys: p pause, r resume, s skip, a abort. Exit status 1 where the batch does not end.
    """
    if tell:
        _tell(rig_file, tell)
        return
    _check_together(live=live, attach=attach, judge=judge, resume=resume, csv_target=csv_target)
    _check_turn(turn, cells, attach=attach)
    alone = not (live or attach or resume or judge or ask or csv_target or report_target or z_law)
    if specification and (not alone or compare):
        raise typer.BadParameter("goes with cells, seed and --json alone", param_hint="--specification")
    _check_ways(z_law, speed, attach=attach, mixed=compare and not alone)
    script = [declared(text) for text in ask or ()]
    console = plain_console(stderr=json_target == "-")
    if attach:
        _attach(rig_file, script, csv_target, report_target, json_target, console)
        return
    rig = load_rig(rig_file, overrides or ())
    places = _places(rig, cells, grid_text, pitch)
    done = read_sheet(Path(csv_target), places) if resume else []
    if len(done) == len(places):
        console.print(f"All {len(done)} cells of {csv_target} are over.")
        return
    angles = read_angles(cells, turn) if cells else []
    how = {**({"seek_speed": speed, "press_speed": speed} if speed else {}), **({"z_law": z_law} if z_law else {})}
    how |= {"turn": turn} if turn else {}

    def planned(changes: dict[str, Any], kinds: Sequence[str] = (), more: Sequence[str] = ()) -> Plan:
        return _planned(
            rig, rig_file, tuple(overrides or ()), places, done, seed, anomalies=anomalies, how={**how, **changes},
            kinds=kinds, more=more, angles=angles,
        )  # fmt: skip

    if specification:
        _hold_against_specification(planned, len(places), json_target, console)
        return
    if compare:
        _compare(planned, json_target, console)
        return
    plan = planned({})
    if plan.assumed:
        console.print(plan.assumed)
    if done:
        console.print(f"{len(done)} cells are over; it goes on with cell {len(done) + 1}.")
    sheet = Sheet(Path(csv_target), places, done) if csv_target else None
    with Steps("cells", len(places) - len(done), console) as steps:
        followers = [Shown(steps), *([sheet] if sheet else [])]
        if live:
            batch = _live(plan, followers, script, console)
        else:
            try:
                batch = inject_batch(
                    plan.rig, rig_file.parent, followers, Script(script), plan.layout, keep=bool(report_target)
                )
            except KeyboardInterrupt:
                _say_how_to_go_on(csv_target)
                raise
    batch.cells[:0] = done
    limit = float(plan.rig.motion.parameters.get("force_limit", 1.4e-3))
    held = float(plan.rig.motion.parameters.get("hold_force", Settings.hold_force))
    lines = judged(batch, limit, held) if judge else []
    _leave(batch, lines, places, plan.rig, (csv_target, report_target, json_target), console)


def _check_together(*, live: bool, attach: bool, judge: bool, resume: bool, csv_target: str) -> None:
    """Options that do not go together. Raises typer.BadParameter."""
    if judge and (live or attach):
        raise typer.BadParameter("only virtual time knows the truth of each cell", param_hint="--judge")
    if resume and (not csv_target or not Path(csv_target).exists()):
        raise typer.BadParameter("needs --csv with the file of the batch that was interrupted", param_hint="--resume")
    if attach and (live or resume):
        raise typer.BadParameter("that rig has its cells already", param_hint="--attach")


def _check_turn(turn: str, cells: Path | None, *, attach: bool) -> None:
    """The same, of the axis that turns the holder."""
    if turn and (cells is None or attach):
        raise typer.BadParameter("needs --cells with a column of that axis", param_hint="--turn")


def _check_ways(z_law: str, speed: float, *, attach: bool, mixed: bool) -> None:
    """The same, of how the tip goes in. mixed: --compare with what it has no use for."""
    if attach and (speed or z_law):
        raise typer.BadParameter("the rig that runs has its own", param_hint="--speed, --z-law")
    if mixed:
        raise typer.BadParameter("goes with cells, anomalies, seed, speed and --json alone", param_hint="--compare")
    if z_law and z_law not in Z_LAWS:
        raise typer.BadParameter(f"{z_law!r:.40}: one of {', '.join(Z_LAWS)}", param_hint="--z-law")


def _planned(
    rig: RigConfig, rig_file: Path, overrides: tuple[str, ...], places: Positions, done: list[Injected], seed: int,
    *, anomalies: float, how: dict[str, Any], kinds: Sequence[str] = (), more: Sequence[str] = (),
    angles: Sequence[float] = (),
) -> Plan:  # fmt: skip
    """The rig with these cells under its tip; its layout is built once. kinds: anomaly of each cell, where they are
    chosen. more: overrides behind all others.
    """
    layout = rig_layout(rig, rig_file.parent)
    chosen = (*overrides, *words(rig, places, seed, anomalies, kinds, fd=layout.fd, how=how, angles=angles), *more)
    if done:
        chosen = (*chosen, f"motion.parameters.first={len(done) + 1}")
    changed = load_rig(rig_file, chosen)
    try:
        refused = [finding.text for finding in check_sensor(changed) if finding.refused]
    except ValueError as error:
        raise RigError([f"{rig_file}: {error}"]) from None
    if refused:
        raise RigError(refused)
    layout = refuse_unschedulable(changed, rig_file.parent, layout)
    return Plan(changed, rig_file, chosen, layout, places, done, assumed(rig))


def _hold_against_specification(planned: Callable[..., Plan], cells: int, json_target: str, console: Console) -> None:
    """Exit status 1 where a bar is missed or a batch did not end."""
    from hil.studies.inject.shown import show_lines
    from hil.studies.inject.specification import ROWS, anomalies_of, ended, named

    lines: list[Line] = []
    with Steps("batches", len(ROWS), console) as steps:
        for row in ROWS:
            plan = planned(dict(row.how), anomalies_of(row, cells), row.words)
            batch = inject_batch(plan.rig, plan.rig_file.parent, layout=plan.layout)
            limit = float(plan.rig.motion.parameters.get("force_limit", Settings.force_limit))
            lines += [*named(row, row.bars(batch, limit)), *ended(row, batch)]
            steps.advance(text=row.name)
    show_lines(console, lines)
    if json_target:
        write_json({"bars": [line._asdict() for line in lines], "cells_each": cells}, json_target)
    if any(line.holds is False for line in lines):
        sys.exit(1)


def _compare(planned: Callable[[dict[str, Any]], Plan], json_target: str, console: Console) -> None:
    """Exit status 1 where a batch did not end."""
    from hil.studies.inject.compare import COMPARED, compared, compared_document, show_compared

    plan = planned({})
    with Steps("z_law", len(COMPARED), console) as steps:

        def batch_of(name: str) -> Batch:
            plan = planned({"z_law": name})
            batch = inject_batch(plan.rig, plan.rig_file.parent, layout=plan.layout)
            steps.advance(text=name)
            return batch

        rows = compared(batch_of)
    given = plan.rig.motion.parameters.get("press_speed", Settings.press_speed)
    show_compared(console, rows, f"{given * 1e3:g} mm/s")
    if json_target:
        write_json({"z_laws": compared_document(rows), "press_speed": given}, json_target)
    if any(row.fault for row in rows):
        sys.exit(1)


def _places(rig: RigConfig, cells: Path | None, grid_text: str, pitch: float) -> Positions:
    """Of the file, else of the grid. Raises RigError where there are too many, or one is beyond the travel."""
    centre = middle(rig)
    places = _grid(grid_text, pitch, centre) if cells is None else read_positions(cells)
    if len(places) > MOST_CELLS:
        raise RigError([f"{len(places)} cells; allowed: up to {MOST_CELLS}"])
    check_within(rig, places, f"--grid {grid_text} --pitch {pitch:g}" if cells is None else str(cells))
    return places


def _grid(text: str, pitch: float, centre: tuple[float, float]) -> Positions:
    found = re.fullmatch("([1-9]|[1-4][0-9]|50)x([1-9]|[1-4][0-9]|50)", text)
    if found is None:
        raise RigError([f"--grid {text[:40]!r}: expected ROWSxCOLUMNS such as 4x5, each from 1 to 50"])
    return grid(int(found[1]), int(found[2]), pitch, centre)


def _live(plan: Plan, followers: Sequence[Follower], script: Sequence[Declared], console: Console) -> Batch:
    from hil.studies.inject.run_live import run_live

    return run_live(plan.rig, plan.rig_file, plan.words, followers, Script(script), console)


def _attach(
    rig: Path, script: Sequence[Declared], csv_target: str, report_target: str, json_target: str, console: Console
) -> None:
    from hil.operate.move import told
    from hil.studies.inject.run_live import cells_of_running, run_attached

    with told("inject"):
        config, places = cells_of_running(rig.stem)
        sheet = Sheet(Path(csv_target), places) if csv_target else None
        with Steps("cells", len(places), console) as steps:
            batch = run_attached(config, [Shown(steps), *([sheet] if sheet else [])], Script(script), console)
    _leave(batch, [], places, config, (csv_target, report_target, json_target), console, again=False)


def _tell(rig: Path, word: str) -> None:
    """Ask the running batch once."""
    from hil.operate.move import told
    from hil.operate.moving import motion

    if word not in WORDS:
        raise typer.BadParameter(f"{word!r}: one of {', '.join(WORDS)}", param_hint="--tell")
    with told("inject"), motion(rig.stem, take=False, activate=False) as mover:
        mover.ask(Request[word.upper()])
    print(f"{word}: taken")


def _leave(
    batch: Batch, lines: Sequence[Line], places: Positions, rig: RigConfig, targets: tuple[str, str, str],
    console: Console, *, again: bool = True,
) -> None:  # fmt: skip
    """Print and write what there is; exit status 1 where the batch did not end, or missed a bar."""
    csv_target, report_target, json_target = targets
    show(console, batch, lines)
    if csv_target:
        console.print(f"cells: {csv_target}")
    if report_target:
        from hil.studies.inject.report import batch_page

        write_text(report_target, batch_page(rig, batch, places, lines))
        console.print(f"page: {report_target}")
    if json_target:
        write_json(document(batch, lines, places), json_target)
    if batch.fault or len(batch.cells) < batch.planned:
        broken = bool(batch.cells) and batch.cells[-1].result.verdict.name == "BROKEN"
        why = batch.failure or batch.fault or ("the tip is broken" if broken else "it was ended before")
        print(f"hil inject: {len(batch.cells)} of {batch.planned} cells: {why}", file=sys.stderr)
        if again:
            _say_how_to_go_on(csv_target)
        sys.exit(1)
    if any(line.holds is False for line in lines):
        sys.exit(1)


def _say_how_to_go_on(csv_target: str) -> None:
    """The command that was typed, with --resume; nothing where no file holds the cells that are over."""
    if csv_target:
        typed = [word for word in ("hil", *sys.argv[1:]) if word != "--resume"]
        print(f"to go on: {shlex.join([*typed, '--resume'])}", file=sys.stderr)
