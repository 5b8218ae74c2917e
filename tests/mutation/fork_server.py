"""Tests run in forks of one process that has imported everything but the project: no interpreter starts per mutant.

A worker owns a private copy of the tree. Byte code is written once, before any mutant; a mutant writes none, so that
nothing of it outlives its fork. Its cache of gains is a private copy too.
"""

import compileall
import os
import resource
import shutil
import sys
import tempfile
from collections.abc import Iterable, Sequence
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path

from tests.mutation.reporting import Reporter, Verdict, die_with_parent, listen
from tests.mutation.rooms import LEFT_OUT

PRELOADED = (
    "pytest", "hypothesis", "_hypothesis_pytestplugin", "numpy", "scipy.linalg", "scipy.optimize", "scipy.integrate",
    "filterpy.kalman", "can", "cantools", "canopen", "pydantic", "tomlkit", "typer", "rich.console", "rich.table",
    "mcap.reader", "mcap_protobuf.writer", "google.protobuf.descriptor_pool", "librt.vecs", "mypy_extensions",
)  # fmt: skip
COPIED = ("drivers", "hil", "sim_plant", "tests", "deploy", "docs", "examples")
MEMORY = 6 << 30
NOT_HERE = "not slow and not live and not vcan and not controller and not systemd"
OPTIONS = ["-q", "--no-header", "--tb=no", "--assert=plain", "--hypothesis-profile=mutants", "-m", NOT_HERE]
OPTIONS += ["-k", " and ".join(f"not {name}" for name in LEFT_OUT)]
OPTIONS += [f"-pno:{plugin}" for plugin in ("cacheprovider", "xdist", "benchmark")]


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
        self._swapped: Connection | None = None
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

    def collect(self, tests: Sequence[str]) -> None:
        """Collect test files once, for `try_swapped`. Raises RuntimeError where one fails on the honest code."""
        private = shutil.copytree(self._home / "cache", self._home / "cache-of-swapped")
        ours, theirs = Pipe()
        if os.fork() == 0:
            ours.close()
            die_with_parent()
            os.environ["XDG_CACHE_HOME"] = str(private)
            resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
            from tests.mutation.swapped import serve

            serve(theirs, [*OPTIONS, f"--basetemp={os.environ['TMPDIR']}/s"], tests)
        theirs.close()
        self._swapped = ours
        ours.send(None)
        honest: Verdict = ours.recv()
        if honest.killed or not honest.passed:
            raise RuntimeError(f"on the honest code: {honest}")

    def try_swapped(self, path: str, mutated: bytes) -> Verdict | None:
        """What the collected tests say of a mutant; None where it cannot be made in a process that has begun."""
        if self._swapped is None:
            return None
        self._swapped.send((path, (self.tree / path).read_bytes(), mutated))
        verdict: Verdict | None = self._swapped.recv()
        return verdict

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
            return listen(reader, child)
        finally:
            if private != cache:
                shutil.rmtree(private, ignore_errors=True)
            shutil.rmtree(self._home / "tmp", ignore_errors=True)
            (self._home / "tmp").mkdir()


def _run_in_child(tests: list[str], writer: int, plugins: Sequence[object], *, everything: bool) -> None:
    """Never returns."""
    try:
        null = os.open(os.devnull, os.O_RDWR)
        log = os.open(os.environ.get("HIL_MUTANT_LOG", os.devnull), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(null, 0)
        os.dup2(log, 1)
        os.dup2(log, 2)
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
        import pytest

        reporter = Reporter(writer)
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
