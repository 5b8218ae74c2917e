#!/usr/bin/env python3
"""What a guest left in RESULTS: shows it, and exits 0 only if tests ran there and every one passed."""

import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path


def tail(path: Path, lines: int) -> str:
    """Last lines of a log, or a word on its absence."""
    if not path.exists():
        return f"({path.name} is missing)"
    return "\n".join(path.read_text(errors="replace").splitlines()[-lines:])


def counts(junit: Path) -> dict[str, int]:
    """Tests, failures (with errors) and skips of a JUnit file."""
    total = {"tests": 0, "failed": 0, "skipped": 0}
    for suite in ElementTree.parse(junit).getroot().iter("testsuite"):
        total["tests"] += int(suite.get("tests", 0))
        total["failed"] += int(suite.get("failures", 0)) + int(suite.get("errors", 0))
        total["skipped"] += int(suite.get("skipped", 0))
    return total


def main(results: Path) -> int:
    """Judge one run. A guest that hung, crashed or tested nothing has failed."""
    print(tail(results / "pytest.log", 200))
    status = results / "status"
    if not status.exists() or not (results / "junit.xml").exists():
        print(f"vm: the guest did not finish; end of its console ({results / 'console.log'}):")
        print(tail(results / "console.log", 60))
        return 1
    total = counts(results / "junit.xml")
    passed = total["tests"] - total["failed"] - total["skipped"]
    print(f"vm: {passed} passed, {total['failed']} failed, {total['skipped']} skipped")
    return 0 if status.read_text().strip() == "0" and passed > 0 and total["failed"] == 0 else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
