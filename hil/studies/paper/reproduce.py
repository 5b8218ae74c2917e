"""`hil reproduce`: every claim of the paper, run again with the setting named in hil/studies/paper/claims.py."""

import multiprocessing
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table

from hil.cli.output import writable, write_json
from hil.studies.paper.claims import Claim
from hil.studies.paper.experiment import STEPS, Job, Run, carry_out, jobs_of
from hil.studies.paper.figures import draw
from hil.studies.paper.outcome import Outcome, find_claims, outcome_of, page, problems, statements

_channel: Any = None  # the worker's way to report its progress


def _start_worker(channel: Any) -> None:
    global _channel
    _channel = channel
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends the pool
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Where the parent is killed. The kernel tells a worker only of the fork server's end, which waits for workers."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _work(job: Job, shorten: float) -> Run:
    last = 0.0

    def report(share: float) -> None:
        nonlocal last
        if share - last >= 0.01:
            last = share
            _channel.put((job, share))

    return carry_out(job, report, shorten)


def run_claims(
    claims: Sequence[Claim], console: Console, workers: int | None = None, shorten: float = 1.0
) -> dict[Job, Run]:
    """Carry out all runs of the claims, over `workers` processes (default: the cores there are), with progress bars."""
    jobs = [job for claim in claims for job in jobs_of(claim.id)]
    jobs.sort(key=_cost, reverse=True)  # the longest first, so that the cores end together
    if not jobs:
        return {}
    context = multiprocessing.get_context("forkserver")
    channel = context.Queue()
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"))
    workers = workers or len(os.sched_getaffinity(0))
    with (
        Progress(*columns, console=console) as bars,
        ProcessPoolExecutor(workers, context, _start_worker, (channel,)) as pool,
    ):
        tasks = {job: bars.add_task(_title(job), total=1.0) for job in jobs}
        futures = {job: pool.submit(_work, job, shorten) for job in jobs}
        try:
            _follow(futures, channel, bars, tasks)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        return {job: futures[job].result() for claim in claims for job in jobs_of(claim.id)}


def _follow(futures: dict[Job, "Future[Run]"], channel: Any, bars: Progress, tasks: dict[Job, Any]) -> None:
    """Move the bars until every run is done; a run that fails raises here."""
    waiting = set(futures)
    while waiting:
        try:
            job, share = channel.get(timeout=0.2)
            bars.update(tasks[job], completed=share)
        except queue.Empty:
            pass
        for job in sorted(waiting):
            if futures[job].done():
                futures[job].result()
                bars.update(tasks[job], completed=1.0)
                waiting.discard(job)


def _cost(job: Job) -> float:
    return job.spec.duration * (2.0**job.step) * (0.1 if job.spec.adaptive else 1.0)


def _title(job: Job) -> str:
    step = "adaptive" if job.spec.adaptive else f"{STEPS[job.step]:g} s"
    return f"{job.claim} ({job.spec.name}, {step})"


def reproduce(
    more: Annotated[list[str] | None, typer.Argument(help="further claims", show_default=False)] = None,
    claims: Annotated[list[str] | None, typer.Option("--claims", help="only these: --claims ID ID ...")] = None,
    json_target: Annotated[
        str, typer.Option("--json", callback=writable, help="write the outcome there; - for standard output")
    ] = "",
    output: Annotated[Path | None, typer.Option(help="folder of the report; default runs/reproduce-<time>")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="processes; default: one per core")] = None,
) -> None:
    """Run the paper's claims and say which hold. Exit status 1 where a figure differs from the independent study's."""
    names = [name.strip() for text in [*(claims or []), *(more or [])] for name in text.split(",") if name.strip()]
    try:
        wanted = find_claims(names)
    except ValueError as error:
        print(f"hil reproduce: {error}", file=sys.stderr)
        sys.exit(2)
    console = Console(stderr=json_target == "-")
    folder = output or Path("runs") / time.strftime("reproduce-%Y%m%d-%H%M%S")
    folder.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    runs = run_claims(wanted, console, workers)
    outcomes = [outcome_of(claim, runs) for claim in wanted]
    figures = draw(runs, folder)
    (folder / "report.html").write_text(page(outcomes, figures), encoding="utf-8")
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
