#!/usr/bin/env python3
"""Prove that the VM lane can fail: break drivers/bus/port.py in ways only SocketCAN shows, one by one, and expect red.

Works in a copy of the committed tree beside the project; exit status 0 when every mutant was caught.
usage: mutants.py     (as root, after `make test-vm` has passed)
"""

import shutil
import subprocess
import sys
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
COPY = PROJECT / ".vm" / "mutant"
TESTS = [
    "tests/vm/test_port.py",
    "-vv",
    "-x",
    "-k",
    "error_frame or echo or own_frames or length_and_flag or classic_from_fd",
]

# name -> (file, what it says, what it is broken to)
MUTANTS = {
    "error frames masked": (
        "drivers/bus/socketcan.py",
        "            self._socket.setblocking(False)\n",
        "            self._socket.setblocking(False)\n            self._socket.setsockopt(101, 2, 0)\n",
    ),
    "error frames taken for traffic": ("drivers/bus/port.py", "elif can_id & ERROR:", "elif can_id & 0:"),
    "FD flag lost": (
        "drivers/bus/port.py",
        "kind = 0 if classic else flags & ~ECHO | FD",
        "kind = 0 if classic else flags & ~ECHO & ~FD",  # the kernel sets it too
    ),
    "own echo not filtered": (
        "drivers/bus/port.py",
        "elif message_flags & _OWN_ECHO and can_id != self._echo_id:",
        "elif 0:",
    ),
}


def prepare() -> None:
    """A clean copy of what is committed, sharing kernel, virtme-ng and Python packages."""
    shutil.rmtree(COPY, ignore_errors=True)
    (COPY / ".vm").mkdir(parents=True)
    archive = subprocess.run(["git", "archive", "HEAD"], cwd=PROJECT, check=True, capture_output=True).stdout
    subprocess.run(["tar", "-x", "-C", str(COPY)], input=archive, check=True)
    (COPY / ".venv").symlink_to(PROJECT / ".venv")
    for name in ("kernel", "venv"):
        (COPY / ".vm" / name).symlink_to(PROJECT / ".vm" / name)


def caught(name: str) -> bool:
    """Whether the lane is red with this mutant in."""
    file, old, new = MUTANTS[name]
    path = COPY / file
    original = path.read_text()
    if original.count(old) != 1:
        sys.exit(f"mutant '{name}': {file} no longer says {old!r} once; renew the mutant")
    path.write_text(original.replace(old, new))
    lane = subprocess.run([str(COPY / "deploy/vm/test.sh"), *TESTS], capture_output=True, text=True, check=False)
    path.write_text(original)
    verdict = [line for line in lane.stdout.splitlines() if line.startswith(("vm: ", "FAILED"))]
    print(f"{'caught' if lane.returncode else 'SURVIVED'}: {name}", *verdict[-6:], sep="\n    ", flush=True)
    return lane.returncode != 0 and any("failed" in line for line in verdict)


def main() -> int:
    """All mutants; 0 when none survived."""
    prepare()
    outcomes = [caught(name) for name in MUTANTS]
    shutil.rmtree(COPY, ignore_errors=True)
    print(f"{sum(outcomes)} of {len(outcomes)} mutants caught")
    return 0 if all(outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
