"""Every claim of the paper, run again over processes with the setting named in hil/studies/paper/claims.py."""

import contextlib
import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from typing import Any

from hil.studies.paper.claims import Claim
from hil.studies.paper.experiment import Job, Run, carry_out, jobs_of

Progress = Callable[[Job, float], None]

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


def jobs_for(claims: Sequence[Claim]) -> list[Job]:
    """All runs of the claims, the longest first, so that the cores end together."""
    return sorted((job for claim in claims for job in jobs_of(claim.id)), key=_cost, reverse=True)


def run_claims(
    claims: Sequence[Claim], progress: Progress, workers: int | None = None, shorten: float = 1.0
) -> dict[Job, Run]:
    """Carry out all runs of the claims, over `workers` processes (default: the cores there are). progress: called with
    a run and the share of it that is done.
    """
    jobs = jobs_for(claims)
    if not jobs:
        return {}
    context = multiprocessing.get_context("forkserver")
    channel = context.Queue()
    workers = workers or len(os.sched_getaffinity(0))
    with ProcessPoolExecutor(workers, context, _start_worker, (channel,)) as pool:
        futures = {job: pool.submit(_work, job, shorten) for job in jobs}
        try:
            _follow(futures, channel, progress)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        return {job: futures[job].result() for claim in claims for job in jobs_of(claim.id)}


def _follow(futures: dict[Job, "Future[Run]"], channel: Any, progress: Progress) -> None:
    """Report until every run is done; a run that fails raises here."""
    waiting = set(futures)
    while waiting:
        with contextlib.suppress(queue.Empty):
            progress(*channel.get(timeout=0.2))
        for job in sorted(waiting):
            if futures[job].done():
                futures[job].result()
                progress(job, 1.0)
                waiting.discard(job)


def _cost(job: Job) -> float:
    return job.spec.duration * (2.0**job.step) * (0.1 if job.spec.adaptive else 1.0)
