"""Child processes that end with their parent: worker pools, and the processes of `hil demo`."""

import ctypes
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Literal

_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)


def die_with_parent(parent: int) -> None:
    """Call in a child: it gets SIGTERM when the parent dies, and exits at once if the parent is dead already."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        os._exit(1)


def worker_pool(workers: int, method: Literal["fork", "spawn"] = "fork") -> ProcessPoolExecutor:
    """A pool of worker processes that end with this one. No fork server: it would be the workers' parent."""
    return ProcessPoolExecutor(workers, multiprocessing.get_context(method), die_with_parent, (os.getpid(),))


class Child:
    """One `hil …` process with its output in a log file."""

    def __init__(self, name: str, arguments: Sequence[str], environment: Mapping[str, str], log: Path) -> None:
        self.name = name
        self.log = log
        parent = os.getpid()
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "hil", *arguments],
                env=dict(environment),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C goes to the parent alone, which ends its children in order
                preexec_fn=lambda: die_with_parent(parent),
            )
        self.pid = self._process.pid

    @property
    def exit_status(self) -> int | None:
        """None while it runs; negative: the signal that ended it."""
        return self._process.poll()

    def fate(self) -> str:
        """How it ended, with the last lines of its log."""
        status = self.exit_status
        if status is None:
            return f"the {self.name} is running"
        how = f"was ended by {signal.Signals(-status).name}" if status < 0 else f"ended with exit status {status}"
        words = self.log.read_text(errors="replace").strip().splitlines()[-5:]
        return "\n  ".join([f"the {self.name} {how}", *words])

    def end(self, timeout_s: float) -> bool:
        """SIGTERM, and SIGKILL when that is not obeyed in time; True where it ended by itself or with status 0."""
        if self.exit_status is None:
            self._process.terminate()
        try:
            return self._process.wait(timeout_s) == 0
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            return False


class Family:
    """All children; leaving the context ends those still running, the first started last."""

    def __init__(self) -> None:
        self.children: list[Child] = []

    def start(self, name: str, arguments: Sequence[str], environment: Mapping[str, str], log: Path) -> Child:
        """Start `hil ARGUMENTS`."""
        child = Child(name, arguments, environment, log)
        self.children.append(child)
        return child

    def ended(self) -> Child | None:
        """The first child that has ended, if any."""
        return next((child for child in self.children if child.exit_status is not None), None)

    def __enter__(self) -> "Family":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for child in reversed(self.children):
            child.end(3.0)
