"""Tests run in forks of one process that has imported everything but the project: no interpreter starts per mutant.

A worker owns a private copy of the tree. Byte code is written once, before any mutant; a mutant writes none, so that
nothing of it outlives its fork. Its cache of gains is a private copy too.
"""

import compileall
import contextlib
import ctypes
import json
import os
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from tests.mutation.rooms import LEFT_OUT

PRELOADED = (
    "pytest", "hypothesis", "_hypothesis_pytestplugin", "numpy", "scipy.linalg", "scipy.optimize", "scipy.integrate",
    "filterpy.kalman", "can", "cantools", "canopen", "pydantic", "tomlkit", "typer", "rich.console", "rich.table",
    "mcap.reader", "mcap_protobuf.writer", "google.protobuf.descriptor_pool", "librt.vecs", "mypy_extensions",
)  # fmt: skip
COPIED = ("drivers", "hil", "sim_plant", "tests", "deploy", "docs", "examples")
CPU_S_PER_TEST = 20  # of processor time, ten times what any honest one takes: a loaded machine makes no hang of one
WALL_S_PER_TEST = 300  # of one that waits for what never comes
MEMORY = 6 << 30
NOT_HERE = "not slow and not live and not vcan and not controller and not systemd"
OPTIONS = ["-q", "--no-header", "--tb=no", "--assert=plain", "--hypothesis-profile=mutants", "-m", NOT_HERE]
OPTIONS += ["-k", " and ".join(f"not {name}" for name in LEFT_OUT)]
OPTIONS += [f"-pno:{plugin}" for plugin in ("cacheprovider", "xdist", "benchmark")]

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


def copy_tree(root: Path, into: Path) -> None:
    """The checkout's sources, tests and data as they are on disk, committed or not."""
    for name in COPIED:
        shutil.copytree(root / name, into / name, ignore=shutil.ignore_patterns("__pycache__", "*.so", "build"))
    for name in ("pyproject.toml", "README.md", "Makefile", "CHANGELOG.md", "LICENSE", "requirements.lock"):
        shutil.copy2(root / name, into / name)


class ForkServer:
    """One worker's tree and its warm interpreter; construct it in a process of its own."""

    def __init__(self, root: Path, scratch: Path) -> None:
        die_with_parent()
        self._home = Path(tempfile.mkdtemp(prefix="", dir=scratch))
        self.tree = self._home / "t"
        self.tree.mkdir()
        copy_tree(root, self.tree)
        for name in ("tmp", "cache"):
            (self._home / name).mkdir()
        tempfile.tempdir = str(self._home / "tmp")
        os.environ.update(
            TMPDIR=str(self._home / "tmp"),
            PYTHONPATH=str(self.tree),
            XDG_CACHE_HOME=str(self._home / "cache"),
            OPENBLAS_NUM_THREADS="1",
        )
        compileall.compile_dir(self.tree, quiet=2)
        os.chdir(self.tree)
        sys.path[:] = [str(self.tree), *(p for p in sys.path if p and Path(p).resolve() != root)]
        for name in PRELOADED:
            __import__(name)
        from hypothesis import Phase, settings

        # A failing example need not be made small here.
        phases = (Phase.explicit, Phase.generate)
        settings.register_profile("mutants", deadline=None, derandomize=True, database=None, phases=phases)
        touched = [name for name in sys.modules if name.split(".")[0] in ("hil", "drivers", "sim_plant")]
        assert not touched, f"imported before the mutation: {touched}"

    def try_mutant(self, path: str, mutated: bytes, tests: Iterable[str], *, everything: bool = False) -> Verdict:
        """Run the tests on one changed file, and put the honest one back."""
        file = self.tree / path
        honest, stat = file.read_bytes(), file.stat()
        file.write_bytes(mutated)
        try:
            return self.run(tests, everything=everything)
        finally:
            file.write_bytes(honest)
            os.utime(file, ns=(stat.st_atime_ns, stat.st_mtime_ns))  # its byte code is valid again

    def run(
        self,
        tests: Iterable[str],
        *,
        honest: bool = False,
        everything: bool = False,
        plugins: Sequence[object] = (),
    ) -> Verdict:
        """Run test files, or single tests, until one fails; with `everything` all of them. plugins: of pytest."""
        cache = self._home / "cache"
        private = cache if honest else Path(shutil.copytree(cache, self._home / "cache-of-mutant"))
        reader, writer = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reader)
            die_with_parent()
            os.setsid()
            os.environ["XDG_CACHE_HOME"] = str(private)
            sys.dont_write_bytecode = not honest
            if not honest:
                os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
            _run_in_child(list(tests), writer, plugins, everything=everything)
        os.close(writer)
        try:
            return _listen(reader, child)
        finally:
            if private != cache:
                shutil.rmtree(private, ignore_errors=True)
            shutil.rmtree(self._home / "tmp", ignore_errors=True)
            (self._home / "tmp").mkdir()


class _Reporter:
    """A pytest plugin: each test's outcome as a line of JSON, and a limit of processor time for each."""

    def __init__(self, writer: int) -> None:
        self._writer = writer
        self._failed: set[str] = set()

    def say(self, what: str, name: str) -> None:
        os.write(self._writer, (json.dumps([what, name]) + "\n").encode())

    def pytest_runtest_logstart(self, nodeid: str, location: object) -> None:
        signal.setitimer(signal.ITIMER_PROF, CPU_S_PER_TEST)
        self.say("start", nodeid)

    def pytest_runtest_logreport(self, report: object) -> None:
        nodeid: str = report.nodeid  # type: ignore[attr-defined]
        if report.failed and nodeid not in self._failed:  # type: ignore[attr-defined]
            self._failed.add(nodeid)
            self.say("failed", nodeid)
        elif report.passed and report.when == "call":  # type: ignore[attr-defined]
            self.say("passed", nodeid)

    def pytest_collectreport(self, report: object) -> None:
        if report.failed:  # type: ignore[attr-defined]
            self.say("failed", f"{report.nodeid} (import)")  # type: ignore[attr-defined]


def _run_in_child(tests: list[str], writer: int, plugins: Sequence[object], *, everything: bool) -> None:
    """Never returns."""
    try:
        null = os.open(os.devnull, os.O_RDWR)
        log = os.open(os.environ.get("HIL_MUTANT_LOG", os.devnull), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(null, 0)
        os.dup2(log, 1)
        os.dup2(log, 2)
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
        signal.signal(signal.SIGPROF, lambda *_: os._exit(3))
        signal.setitimer(signal.ITIMER_PROF, CPU_S_PER_TEST)
        import pytest

        reporter = _Reporter(writer)
        for path in tests:
            options = [*OPTIONS] if everything else [*OPTIONS, "-x"]
            options.append(f"--basetemp={os.environ['TMPDIR']}/b")  # short: a socket's path has 107 characters at most
            status = pytest.main([*options, path], plugins=[reporter, *plugins])
            if status not in (0, 5) and not everything:
                if status != 1:
                    reporter.say("failed", f"{path} (pytest ended with {status})")
                break
        reporter.say("end", "")
    finally:
        os._exit(0)


def _listen(reader: int, child: int) -> Verdict:
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
