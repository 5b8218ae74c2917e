"""`hil reproduce`: which of the paper's claims hold."""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table

from drivers.base.named_file import write_text
from hil.cli.console import plain_console
from hil.cli.options import JsonTarget
from hil.cli.output import write_json
from hil.studies.paper.experiment import STEPS, Job
from hil.studies.paper.figures import draw
from hil.studies.paper.outcome import Outcome, find_claims, outcome_of, page, problems, statements
from hil.studies.paper.reproduce import jobs_for, run_claims


def _title(job: Job) -> str:
    step = "adaptive" if job.spec.adaptive else f"{STEPS[job.step]:g} s"
    return f"{job.claim} ({job.spec.name}, {step})"


def reproduce(
    more: Annotated[list[str] | None, typer.Argument(help="further claims", show_default=False)] = None,
    claims: Annotated[list[str] | None, typer.Option("--claims", help="only these: --claims ID ID ...")] = None,
    json_target: JsonTarget = "",
    output: Annotated[
        Path | None, typer.Option("--out", "-o", help="folder of the report; default runs/reproduce-TIME")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="processes; default: one per core")] = None,
) -> None:
    """Run the paper's claims and say which hold. Exit status 1 where a figure differs from the independent study's."""
    names = [name.strip() for text in [*(claims or []), *(more or [])] for name in text.split(",") if name.strip()]
    try:
        wanted = find_claims(names)
    except ValueError as error:
        print(f"hil reproduce: {error}", file=sys.stderr)
        sys.exit(2)
    console = plain_console(stderr=json_target == "-")
    folder = output or Path("runs") / time.strftime("reproduce-%Y%m%d-%H%M%S")
    folder.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"))
    with Progress(*columns, console=console) as bars:
        tasks = {job: bars.add_task(_title(job), total=1.0) for job in jobs_for(wanted)}
        runs = run_claims(wanted, lambda job, share: bars.update(tasks[job], completed=share), workers)
    outcomes = [outcome_of(claim, runs) for claim in wanted]
    figures = draw(runs, folder)
    write_text(folder / "report.html", page(outcomes, figures))
    _show(console, outcomes)
    console.print(f"report {folder / 'report.html'} with {len(figures)} figures; {time.monotonic() - started:.0f} s")
    if json_target:
        write_json({"claims": [outcome.as_json() for outcome in outcomes]}, json_target)
    doubts = [line for outcome in outcomes for line in problems(outcome)]
    for line in doubts:
        print(f"hil reproduce: {line}", file=sys.stderr)
    sys.exit(1 if doubts else 0)


def _show(console: Console, outcomes: Sequence[Outcome]) -> None:
    for outcome in outcomes:
        table = Table(show_header=False, box=None, padding=(0, 2), title=outcome.claim.id, title_justify="left")
        for key, value in statements(outcome):
            table.add_row(key, value)
        console.print(table)
        console.print()
