"""Try every mutant of a cosmic-ray session: python run.py SESSION.sqlite; the folder it is run in is copied per worker.

Each worker imports what the tests need but does not mutate (pytest, numpy, hypothesis, the frame layouts), then forks
once per mutant; starting an interpreter per mutant, as cosmic-ray's own executor does, costs ten times the CPU.
"""

import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from cosmic_ray.mutating import apply_mutation
from cosmic_ray.plugins import get_operator
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import MutationSpec, TestOutcome, WorkerOutcome, WorkItem, WorkResult

TESTS = ["tests/cycle/test_gate.py", "tests/cycle/test_state_machine.py"]
OPTIONS = ["-x", "-q", "--no-header", "--noconftest", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:benchmark"]
TIMEOUT_S = 120  # of a mutant that never ends; an honest run takes a second


def warm_up(source: Path) -> None:
    """A copy of the tree for this worker, and all imports done that no mutant touches."""
    copy = Path(tempfile.mkdtemp(dir=source.parent))
    shutil.copytree(source, copy, dirs_exist_ok=True)
    os.chdir(copy)
    sys.path.insert(0, str(copy))
    from hypothesis import Phase, settings

    from drivers.config import BusConfig
    from drivers.protocols import device_protocol, host_protocol

    # A failing example need not be made small here.
    phases = (Phase.explicit, Phase.generate)
    settings.register_profile("mutants", deadline=None, derandomize=True, database=None, phases=phases)
    settings.load_profile("mutants")
    for make in (host_protocol, device_protocol):
        make(BusConfig(), 2, [1.0, 1.0], copy)
    touched = [name for name in sys.modules if name.startswith("hil.")]
    assert not touched, f"imported before the mutation: {touched}"


def passes() -> bool:
    """Whether the tests pass in the working folder, in a fork."""
    child = os.fork()
    if child == 0:
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        import pytest

        os._exit(0 if pytest.main([*OPTIONS, *TESTS]) == 0 else 1)
    limit = time.monotonic() + TIMEOUT_S
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return status == 0
        if time.monotonic() > limit:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return False
        time.sleep(0.005)


def honest(_: int) -> bool:
    """Whether the unmutated code passes here: else every mutant would seem killed."""
    return passes()


def attempt(item: WorkItem) -> tuple[str, WorkResult]:
    """Apply one mutant, test it, and put the honest code back."""
    (mutation,) = item.mutations
    honest_code, mutated_code = apply_mutation(mutation.module_path, _operator(mutation), mutation.occurrence)
    if mutated_code is None:
        return item.job_id, WorkResult(WorkerOutcome.NO_TEST)
    try:
        survived = passes()
    finally:
        mutation.module_path.write_text(honest_code, encoding="utf-8")
    outcome = TestOutcome.SURVIVED if survived else TestOutcome.KILLED
    return item.job_id, WorkResult(WorkerOutcome.NORMAL, "", outcome, _difference(mutation, mutated_code))


def _operator(mutation: MutationSpec) -> object:
    return get_operator(mutation.operator_name)(**mutation.operator_args)


def _difference(mutation: MutationSpec, mutated_code: str) -> str:
    line = mutation.start_pos[0] - 1
    return mutated_code.splitlines()[line].strip()


def main(session: str, only: Sequence[str]) -> None:
    """Fill the session's results; with job identifiers, try only those."""
    workers = os.cpu_count() or 1
    with use_db(session, WorkDB.Mode.open) as database:
        items = [item for item in database.pending_work_items if not only or item.job_id in only]
        context = multiprocessing.get_context("spawn")
        with context.Pool(workers, warm_up, (Path.cwd(),)) as pool:
            if not all(pool.map(honest, range(workers), chunksize=1)):
                sys.exit("the tests fail on the honest code; nothing was tried")
            for number, (job, result) in enumerate(pool.imap_unordered(attempt, items), 1):
                database.set_result(job, result)
                print(f"\r{number} of {len(items)} mutants tried", end="", file=sys.stderr, flush=True)
        print(file=sys.stderr)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
