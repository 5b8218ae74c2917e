"""Try every attack on a live rig of its own. Exit status 0: all held; 1: some did not; 77: it cannot be tried here."""

import json
import os
import platform
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.attacks import on_commands, on_files, on_goals, on_processes, on_zenoh
from tests.attacks.registry import ATTACKS, Result, tried
from tests.attacks.target import Target

MODULES = (on_zenoh, on_commands, on_goals, on_processes, on_files)
LEAST = 30


def show(result: Result) -> None:
    """One line each: attack, expected, seen."""
    print(f"{'held  ' if result.held else 'FAILED'} {result.attack}")
    print(f"         expected: {result.expected}\n         seen:     {result.seen[:300]}", flush=True)


def main(out: Path, only: str) -> int:
    """Returns the exit status."""
    if os.geteuid() != 0:
        print("make attacks needs root: it becomes other users and makes network namespaces", file=sys.stderr)
        return 77
    began = time.monotonic()
    results: list[Result] = []
    with tempfile.TemporaryDirectory(prefix="hil-attacks-") as directory:
        os.chmod(directory, 0o755)
        target = Target(Path(directory))
        try:
            target.begin()
            for listed in sorted(ATTACKS, key=lambda listed: listed.last):
                if only in listed.name:
                    for result in tried(listed, target):
                        show(result)
                        results.append(result)
        finally:
            target.close()
    held = sum(result.held for result in results)
    before = Counter(result.before for result in results)
    took_s = time.monotonic() - began
    summary = {"attacks": len(results), "held": held, "seconds": round(took_s, 1), "python": platform.python_version()}
    out.write_text(
        json.dumps({**summary, "before": before, "results": [result._asdict() for result in results]}, indent=1) + "\n"
    )
    print("on the code before: " + ", ".join(f"{count} {fate}" for fate, count in sorted(before.items())))
    print(f"ran: {len(results)} attacks, {held} held, {took_s:.0f} s; {out}")
    return 0 if held == len(results) and (only or held >= LEAST) else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else ""))
