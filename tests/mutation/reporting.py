"""What a forked process that runs tests says of them through a pipe, and how it is ended where it never would."""

import contextlib
import ctypes
import json
import os
import select
import signal
import time
from typing import NamedTuple

CPU_S_PER_TEST = 20  # of processor time, ten times what any honest one takes: a loaded machine makes no hang of one
WALL_S_PER_TEST = 300  # of one that waits for what never comes

_PR_SET_PDEATHSIG = 1


def die_with_parent() -> None:
    """Whoever ends the run ends what it started, too."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


class Verdict(NamedTuple):
    """failed: names of the tests that failed, the first one only unless all were asked for. passed: those that passed.
    hung: ended by a time limit.
    """

    failed: list[str]
    passed: list[str]
    hung: bool

    @property
    def killed(self) -> bool:
        """Whether something noticed."""
        return self.hung or bool(self.failed)


class Reporter:
    """A pytest plugin: each test's outcome as a line of JSON, and a limit of processor time for each."""

    def __init__(self, writer: int) -> None:
        self._writer = writer
        self.failed: set[str] = set()
        signal.signal(signal.SIGPROF, lambda *_: os._exit(3))
        signal.setitimer(signal.ITIMER_PROF, CPU_S_PER_TEST)

    def say(self, what: str, name: str) -> None:
        os.write(self._writer, (json.dumps([what, name]) + "\n").encode())

    def pytest_runtest_logstart(self, nodeid: str, location: object) -> None:
        signal.setitimer(signal.ITIMER_PROF, CPU_S_PER_TEST)
        self.say("start", nodeid)

    def pytest_runtest_logreport(self, report: object) -> None:
        nodeid: str = report.nodeid  # type: ignore[attr-defined]
        if report.failed and nodeid not in self.failed:  # type: ignore[attr-defined]
            self.failed.add(nodeid)
            self.say("failed", nodeid)
        elif report.passed and report.when == "call":  # type: ignore[attr-defined]
            self.say("passed", nodeid)

    def pytest_collectreport(self, report: object) -> None:
        if report.failed:  # type: ignore[attr-defined]
            self.say("failed", f"{report.nodeid} (import)")  # type: ignore[attr-defined]


def listen(reader: int, child: int) -> Verdict:
    """Gather what the child says until it ends, or takes too long over one test."""
    failed: list[str] = []
    passed: list[str] = []
    running, rest, ended, limit = "", b"", False, time.monotonic() + WALL_S_PER_TEST
    while True:
        ready, _, _ = select.select([reader], [], [], max(0.0, limit - time.monotonic()))
        chunk = os.read(reader, 65536) if ready else b""
        if not chunk:
            break
        limit = time.monotonic() + WALL_S_PER_TEST
        *lines, rest = (rest + chunk).split(b"\n")
        for line in lines:
            what, name = json.loads(line)
            if what == "start":
                running = name
            elif what == "end":
                ended = True
            else:
                (failed if what == "failed" else passed).append(name)
        if ended:
            break
    os.close(reader)
    _end_session(child)
    if not ended:
        failed.append(running or "(import)")
    return Verdict(failed, passed, not ended)


def _end_session(child: int) -> None:
    """The child and whatever it started."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
