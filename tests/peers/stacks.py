"""Stacks in other languages against our drives and our master: tests/foreign, which has the npm package canopen."""

import re
import subprocess
import sys
from collections.abc import Iterator

from tests.peers.table import DIFFERS, NOT_RUN, PASSED, Row
from tests.support.paths import ROOT

PEER = "npm canopen"
_LINE = re.compile(r"^(PASSED|FAILED|ERROR|SKIPPED) (.+)$", re.MULTILINE)
_RESULTS = {"PASSED": PASSED, "SKIPPED": NOT_RUN}


def rows(*, few: bool) -> Iterator[Row]:
    """A row a test. The short run leaves them out."""
    if few:
        yield Row(PEER, "tests/foreign", NOT_RUN, "takes a minute: make peers without --few")
        return
    words = [sys.executable, "-m", "pytest", "-q", "-rA", "--tb=line", "tests/foreign"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=900, check=False)
    found = _LINE.findall(done.stdout)
    if not found:
        yield Row(PEER, "tests/foreign", DIFFERS, f"pytest ended with {done.returncode}: {done.stderr[-300:]}")
    for word, rest in found:
        test, _, told = rest.partition(" - ")
        yield Row(PEER, test, _RESULTS.get(word, DIFFERS), told)
