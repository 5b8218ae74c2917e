"""Who does the work of a study: processes of this machine, or the workers of a dask.distributed cluster.

Rules:
- A job holds all that its work needs (the rig with the texts of its plug-ins), and its result depends on the job alone:
  the same bytes from one core, many, or a cluster.
- Results come in the order of the jobs. A worker that is lost is replaced by another, its jobs done again.
- What is done is kept until all is: a run that was interrupted goes on where it was.
"""

import hashlib
import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

from drivers.base.runtime import RuntimeDirectoryError, make_private
from hil.cli.processes import worker_pool
from hil.rig.control_path import control_path
from hil.rig.extras import install_command
from hil.rig.schema import RigError

CONNECT_TIMEOUT_S = 10
RETRIES = 3  # of a job whose worker was lost, or that raised there
UNFINISHED = Path("runs") / ".unfinished"  # what interrupted runs have done, below the working directory

_Job = TypeVar("_Job")
_Result = TypeVar("_Result")


class Crew(NamedTuple):
    """run: results of a function of a module, job by job, in order. size: how many jobs run at a time."""

    run: Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]
    size: int


@contextmanager
def crew(workers: int, scheduler: str = "", method: Literal["fork", "spawn"] = "fork") -> Iterator[Crew]:
    """So many processes of this machine (0: one a core), or the cluster whose scheduler is named. Raises RigError."""
    with _cluster(scheduler) if scheduler else _processes(workers or len(os.sched_getaffinity(0)), method) as found:
        yield found


@contextmanager
def _processes(workers: int, method: Literal["fork", "spawn"]) -> Iterator[Crew]:
    with worker_pool(workers, method) as pool:
        try:
            yield Crew(lambda function, work: pool.map(function, work), workers)
        except BaseException:  # Ctrl-C above all: leaving the pool would do all other jobs first
            pool.shutdown(cancel_futures=True)
            raise


@contextmanager
def _cluster(address: str) -> Iterator[Crew]:
    try:
        from distributed import Client  # type: ignore[attr-defined,unused-ignore]
    except ImportError:
        raise RigError([f"--scheduler needs the extra: {install_command('cluster')}"]) from None
    connect: Any = Client
    try:
        client = connect(address, timeout=CONNECT_TIMEOUT_S)
    except (OSError, ValueError) as error:
        raise RigError([f"--scheduler {address}: {error}"]) from None

    def run(function: Callable[[Any], Any], work: Sequence[Any]) -> Iterator[Any]:
        jobs = [(function, job) for job in work]
        for future in client.map(_on_worker, jobs, pure=False, retries=RETRIES, key=_keys(function, work)):
            yield future.result()

    with client:
        yield Crew(run, max(1, sum(client.ncores().values())))


def _keys(function: Callable[[Any], Any], work: Sequence[Any]) -> list[str]:
    run = os.urandom(6).hex()
    return [f"{function.__name__}-{run}-{number}" for number in range(len(work))]


def _on_worker(task: tuple[Callable[[Any], Any], Any]) -> Any:
    """A job in a process of its own: a worker runs several threads, and some jobs fork."""
    command = [sys.executable, "-c", "from hil.studies.crew import alone; alone()"]
    done = subprocess.run(command, input=pickle.dumps(task), capture_output=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{task[0].__name__}: exit status {done.returncode}: {done.stderr.decode()[-2000:]}")
    kind, value = pickle.loads(done.stdout)
    if kind == "raised":
        raise value
    return value


def alone() -> None:
    """The job on standard input, its result on standard output."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what the job prints is not its result
    function, job = pickle.load(sys.stdin.buffer)
    try:
        answer = ("result", function(job))
    except Exception as error:
        answer = ("raised", error)
    with out:
        pickle.dump(answer, out)


def resumed(
    found: Crew, function: Callable[[_Job], _Result], work: Sequence[_Job], folder: Path = UNFINISHED
) -> Iterator[_Result]:
    """All results in order; those that an interrupted run of the same work has left in `folder` are not done again.

    Where nothing can be kept there, nothing is.
    """
    place = folder / _name(function, work)
    with suppress(RuntimeDirectoryError):
        make_private(place)
    kept = {number: answer for number in range(len(work)) if (answer := _load(place / f"{number}.pickle"))}
    fresh = iter(found.run(function, [job for number, job in enumerate(work) if number not in kept]))
    for number in range(len(work)):
        if number in kept:
            (result,) = kept.pop(number)
        else:
            result = next(fresh)
            _keep(place / f"{number}.pickle", result)
        yield result
    shutil.rmtree(place, ignore_errors=True)


def _load(file: Path) -> tuple[Any] | None:
    """A result that was kept; None where there is none, or none that is whole."""
    try:
        make_private(file.parent)
        return (pickle.loads(file.read_bytes()),)
    except (OSError, RuntimeDirectoryError, pickle.UnpicklingError, EOFError):
        return None


def _keep(file: Path, result: Any) -> None:
    with suppress(OSError):  # a full disk, or another run of the same work that has just ended
        temporary = file.with_suffix(f".{os.getpid()}.new")
        temporary.write_bytes(pickle.dumps(result))
        temporary.replace(file)


def _name(function: Callable[[Any], Any], work: Sequence[Any]) -> str:
    """Of this work with this code: another version of hil begins anew."""
    code = hashlib.sha256(control_path().encode())
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        code.update(path.read_bytes())
    for job in work:
        code.update(pickle.dumps(job))
    return f"{function.__name__}-{code.hexdigest()[:24]}"
