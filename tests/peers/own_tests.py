"""Peers' own test suites, run by pytest with a plug-in that puts ours in the place of theirs."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tests.peers.sources import UnavailableError, source, tools
from tests.peers.table import DIFFERS, NOT_RUN, PASSED, Row
from tests.support.paths import ROOT

TEST_S = 10.0  # at most, for one of their tests


class Suite(NamedTuple):
    """files: of the peer's source. few: those of a short run. without: their tests that reach for other networks.

    plugins: modules of this package.
    """

    peer: str
    files: Sequence[str]
    few: Sequence[str]
    plugins: Sequence[str]
    without: str = ""


SUITES = (
    Suite(
        "python-can",
        [
            f"test/{name}.py"
            for name in (
                "back2back_test",
                "contextmanager_test",
                "listener_test",
                "network_test",
                "notifier_test",
                "simplecyclic_test",
                "test_bus",
                "test_interface_virtual",
                "test_message_filtering",
                "test_viewer",
                "zero_dlc_test",
            )
        ],
        [],
        ["on_local_bus"],
        without="ulticast",
    ),
    Suite(
        "canopen",
        ["test"],
        ["test/test_sdo.py", "test/test_emcy.py", "test/test_pdo.py"],
        ["on_local_bus", "on_drive"],
    ),
)


def run_suite(suite: Suite, *, few: bool) -> list[Row]:
    """Rows of a peer's own tests that met something of ours; what failed is run once more, and that is said."""
    files = suite.few if few else suite.files
    if not files:
        return []
    try:
        folder = source(suite.peer)
        path = tools()
    except UnavailableError as error:
        return [Row(suite.peer, "its own tests", NOT_RUN, str(error))]
    rows = _pytest(suite, folder, path, files)
    failed = [row.test for row in rows if row.result == DIFFERS]
    if failed:
        again = {row.test: row for row in _pytest(suite, folder, path, failed)}
        rows = [_second(row, again.get(row.test)) for row in rows]
    return rows


def _second(row: Row, again: Row | None) -> Row:
    if row.result == DIFFERS and again is not None and again.result == PASSED:
        return row._replace(result=PASSED, told=f"the second time; before: {row.told}")
    return row


def _pytest(suite: Suite, folder: Path, path: Path, tests: Sequence[str]) -> list[Row]:
    plugins = [word for name in ("results", *suite.plugins) for word in ("-p", f"tests.peers.{name}")]
    words = ["-q", "-s", "-c", os.devnull, "--rootdir", ".", "-p", "no:cacheprovider", *plugins]
    without = ["-k", f"not {suite.without}"] if suite.without else []
    with tempfile.TemporaryDirectory(prefix="hil-peers-") as place:
        results = Path(place) / "results.jsonl"
        environment = os.environ | {
            "PYTHONPATH": f"{ROOT}{os.pathsep}{path}",
            "HIL_RUNTIME_DIR": place,
            "HIL_PEERS_RESULTS": str(results),
            "HIL_PEERS_PATIENCE": f"{TEST_S:g}",
        }
        done = subprocess.run(
            [sys.executable, "-m", "pytest", *words, *without, *tests],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=900,
            check=False,
        )
        if not results.is_file():
            return [
                Row(suite.peer, "its own tests", DIFFERS, f"pytest ended with {done.returncode}: {done.stderr[-300:]}")
            ]
        return list(_rows(suite.peer, results.read_text()))


def _rows(peer: str, text: str) -> list[Row]:
    """One row a test: the worst of its phases. A test that the peer itself skips is none."""
    found: dict[str, Row] = {}
    for line in text.splitlines():
        told = json.loads(line)
        if told["outcome"] == "skipped":
            continue
        result = PASSED if told["outcome"] == "passed" else DIFFERS
        said = told["text"].strip().splitlines()
        row = Row(peer, told["test"], result, said[-1].removeprefix("E").strip() if said else "", own=True)
        if row.test not in found or result == DIFFERS:
            found[row.test] = row
    return list(found.values())
