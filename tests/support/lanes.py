"""How many tests of which kind ran: a line that .ci/run collects. Hooks for tests/conftest.py.

unit: no process but pytest's own. lockstep: the whole loop in virtual time. live-local: processes on the local bus.
"""

from collections import Counter

import pytest

from hil.rig.provenance import control_path

KINDS = ("unit", "lockstep", "live-local")
_WHOLE_LOOPS = ("hil.virtual.lockstep", "hil.studies.fault_campaign")  # what brings virtual time into a test's module


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "lockstep: the whole loop in virtual time (set by tests/support/lanes.py)")


def _runs_lockstep(item: pytest.Function) -> bool:
    if "lockstep" in item.fixturenames:
        return True
    origins = (getattr(thing, "__module__", None) or "" for thing in vars(item.module).values())
    return any(origin.startswith(_WHOLE_LOOPS) for origin in origins)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    not_compiled = pytest.mark.skip(reason="replaces methods of classes that are compiled here")
    for item in items:
        if item.get_closest_marker("replaces_methods") and control_path() == "compiled":
            item.add_marker(not_compiled)
        if isinstance(item, pytest.Function) and _runs_lockstep(item):
            item.add_marker("lockstep")


def _kind(keywords: dict[str, object]) -> str:
    return "live-local" if "live" in keywords else "lockstep" if "lockstep" in keywords else "unit"


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    reports = [report for outcome in ("passed", "failed") for report in terminalreporter.stats.get(outcome, [])]
    ran = Counter(_kind(report.keywords) for report in reports if report.when == "call")
    terminalreporter.write_line("ran: " + ", ".join(f"{kind} {ran[kind]}" for kind in KINDS))
