"""Which tests a lane runs, and how many of which kind ran: a line that .ci/run collects. Hooks for tests/conftest.py.

unit: no process but pytest's own. lockstep: the whole loop in virtual time. live-local: processes on the local bus.

`--slice N` runs one in N of the slow and the long tests, and on the compiled build of the live ones and of those that
merely use it, drawn by the commit: CI sees others with every commit. `make test-nightly` and `make test-compiled` see
them all.
"""

import hashlib
import subprocess
from collections import Counter
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

from hil.rig.provenance import control_path
from tests.support.paths import ROOT

KINDS = ("unit", "lockstep", "live-local")
_WHOLE_LOOPS = (  # what brings virtual time into a module of tests
    "hil.virtual.lockstep",
    "hil.studies.fault_campaign",
    "tests.support.tip",
)

# What runs the same code in either build, and so once: these read files, sources and tables, or compute on arrays,
# which the build leaves to the interpreter (deploy/compiled/build.py). Each with the files that do need the build.
SAME_IN_BOTH_BUILDS = {
    "tests/analysis": (),
    "tests/cli": (),
    "tests/golden": (),
    "tests/project": ("test_bench.py", "test_compiled.py", "test_examples.py", "test_wheel.py"),
    "tests/rig": ("test_checks.py", "test_user_tasks.py"),
}
# What is not compiled, and uses what is as anybody does.
_USERS = ("events", "identify", "operate", "page", "runs", "studies", "telemetry")
USERS_OF_THE_BUILD = tuple(f"tests/{name}" for name in _USERS)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slice", type=int, default=1, metavar="N", help="one in N of what is long, by commit")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "lockstep: the whole loop in virtual time (set by tests/support/lanes.py)")


def _runs_lockstep(item: pytest.Function) -> bool:
    if "lockstep" in item.fixturenames:
        return True
    return _brings_virtual_time(item.module)


@cache
def _brings_virtual_time(module: ModuleType) -> bool:
    origins = (getattr(thing, "__module__", None) or "" for thing in vars(module).values())
    return any(origin.startswith(_WHOLE_LOOPS) for origin in origins)


def _folder(path: Path) -> str:
    return path.parent.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else ""


def _same_in_both_builds(path: Path) -> bool:
    folder = _folder(path)
    return folder in SAME_IN_BOTH_BUILDS and path.name not in SAME_IN_BOTH_BUILDS[folder]


def commit() -> str:
    """The checkout's, or nothing where there is none."""
    asked = subprocess.run(["git", "-C", ROOT, "rev-parse", "HEAD"], capture_output=True, text=True, check=False)
    return asked.stdout.strip()


def drawn(names: list[str], one_in: int, seed: str) -> set[str]:
    """One in so many of these, rounded up: those whose hash with the seed is least."""
    rank = {name: hashlib.sha256(f"{seed} {name}".encode()).digest() for name in names}
    return set(sorted(names, key=rank.__getitem__)[: -(-len(names) // one_in)])


def _is_sliced(item: pytest.Item) -> bool:
    if any(item.get_closest_marker(name) for name in ("long", "slow")):
        return True
    return control_path() == "compiled" and (
        bool(item.get_closest_marker("live")) or _folder(item.path).startswith(USERS_OF_THE_BUILD)
    )


def _slice(config: pytest.Config, items: list[pytest.Item]) -> None:
    sliced = [item for item in items if _is_sliced(item)]
    kept = drawn([item.nodeid for item in sliced], config.getoption("--slice"), commit())
    left_out = [item for item in sliced if item.nodeid not in kept]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if item not in set(left_out)]


def _leave_browsers_out(config: pytest.Config, items: list[pytest.Item]) -> None:
    """A browser is on few machines, and no lane of .ci/run may need one: `make test-browser` asks for them."""
    if "browser" not in config.option.markexpr:
        theirs = [item for item in items if item.get_closest_marker("browser")]
        config.hook.pytest_deselected(items=theirs)
        items[:] = [item for item in items if item not in set(theirs)]


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    _leave_browsers_out(config, items)
    not_compiled = pytest.mark.skip(reason="replaces methods of classes that are compiled here")
    once = pytest.mark.skip(reason="runs the same code in either build: tests/support/lanes.py")
    compiled = control_path() == "compiled"
    for item in items:
        if compiled and item.get_closest_marker("replaces_methods"):
            item.add_marker(not_compiled)
        elif compiled and not item.get_closest_marker("slow") and _same_in_both_builds(item.path):
            item.add_marker(once)
        if isinstance(item, pytest.Function) and _runs_lockstep(item):
            item.add_marker("lockstep")
    if config.getoption("--slice") > 1 and not config.getoption("lf"):  # what failed was in the slice
        _slice(config, items)


def _kind(keywords: dict[str, object]) -> str:
    return "live-local" if "live" in keywords else "lockstep" if "lockstep" in keywords else "unit"


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    reports = [report for outcome in ("passed", "failed") for report in terminalreporter.stats.get(outcome, [])]
    ran = Counter(_kind(report.keywords) for report in reports if report.when == "call")
    terminalreporter.write_line("ran: " + ", ".join(f"{kind} {ran[kind]}" for kind in KINDS))
