"""A pytest plug-in: each test's outcome as a line of JSON, and no test that takes longer than a while.

The file is named by HIL_PEERS_RESULTS; HIL_PEERS_PATIENCE is the while, in seconds. Only tests that met something of
ours are told: what meets it calls `met`.
"""

import json
import os
import signal
from collections.abc import Generator
from types import FrameType

import pytest

_PATIENCE_S = float(os.environ.get("HIL_PEERS_PATIENCE", "10"))
_running = [""]
_met: set[str] = set()
_told: list[dict[str, str]] = []


def met() -> None:
    """The running test has something of ours under it; so have the others of its class, which share what it made."""
    _met.add(_group(_running[0]))


def _group(test: str) -> str:
    return test.rpartition("::")[0] if test.count("::") > 1 else test


def _too_long(_signal: int, _frame: FrameType | None) -> None:
    raise TimeoutError(f"not done after {_PATIENCE_S:g} s")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    _running[0] = item.nodeid
    before = signal.signal(signal.SIGALRM, _too_long)
    signal.setitimer(signal.ITIMER_REAL, _PATIENCE_S, 1.0)  # again, where the test swallowed the first
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.when == "call" or not report.passed:
        text = str(report.longrepr[2]) if isinstance(report.longrepr, tuple) else report.longreprtext
        _told.append({"test": report.nodeid, "outcome": report.outcome, "text": text[-3000:]})


def pytest_sessionfinish() -> None:
    with open(os.environ["HIL_PEERS_RESULTS"], "w") as file:
        file.writelines(json.dumps(line) + "\n" for line in _told if _group(line["test"]) in _met)
