"""The hostile set-points on every Python that is found: `python -m tests.support.hostile_everywhere`.

This one, CPython 3.11 to 3.14 from PATH or pyenv, the compiled build (`make compiled`), and arm64 under qemu. They need
no package. --arm64: a folder with another machine's files, in which usr/bin/python3.11 is. On Debian, of any machine:

    apt-get -o APT::Architecture=arm64 -o APT::Architectures=arm64 download libc6 libpython3.11-minimal \
        libpython3.11-stdlib python3.11-minimal zlib1g libexpat1
    for package in *.deb; do dpkg -x "$package" FOLDER; done        # qemu-user-static has qemu-aarch64-static

(with apt's directories of its own, so that this machine's lists stay). Exit status 1: one hash is another.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from tests.support.hashes import NoInterpreterError, bare_interpreter
from tests.support.paths import ROOT

VERSIONS = ("3.11", "3.12", "3.13", "3.14")
COMPILED = ROOT / ".venv-compiled" / "bin" / "python"
_SHA256 = re.compile(r"sha256='([0-9a-f]{64})'")


def commands(arm64: Path | None) -> Iterator[tuple[str, list[str], str]]:
    """Name of each, the command of its Python, and why it is left out: one of the two is empty."""
    yield "this Python", [sys.executable], ""
    for version in VERSIONS:
        try:
            yield f"CPython {version}", [str(bare_interpreter(version))], ""
        except NoInterpreterError as reason:
            yield f"CPython {version}", [], str(reason)
    yield "compiled", [str(COMPILED)] if COMPILED.exists() else [], "make compiled has not been run"
    emulator = shutil.which("qemu-aarch64-static") or shutil.which("qemu-aarch64")
    found = sorted(arm64.glob("usr/bin/python3.[0-9]*")) if arm64 else []
    if emulator and found:
        yield "arm64, qemu", [emulator, "-L", str(arm64), str(found[0])], ""
    else:
        yield "arm64, qemu", [], "no Python for arm64: --arm64" if emulator else "qemu-aarch64-static is not installed"


def hashes_of(python: list[str], goals: int, seeds: int) -> list[str]:
    """Of each seed. Raises RuntimeError with what that Python said."""
    words = ["-B", "-m", "tests.support.hostile_goals", "--goals", str(goals), "--seeds", str(seeds)]
    place = {"PYTHONSAFEPATH": "1"} if python == [str(COMPILED)] else {"PYTHONPATH": str(ROOT)}
    told = subprocess.run(
        [*python, *words], cwd=ROOT, env={**os.environ, **place}, capture_output=True, text=True, check=False
    )
    if told.returncode:
        raise RuntimeError(told.stderr.strip().splitlines()[-1])
    return _SHA256.findall(told.stdout)


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--goals", type=int, default=2000)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--arm64", type=Path, help="folder with an arm64 Python")
    words = parser.parse_args()
    first: list[str] = []
    different = 0
    for name, python, why in commands(words.arm64):
        if not python:
            print(f"{name:14} left out: {why}")
            continue
        found = hashes_of(python, words.goals, words.seeds)
        first = first or found
        different += found != first
        verdict = "same" if found == first else "DIFFERENT"
        print(f"{name:14} {verdict}: {' '.join(text[:12] for text in found)}", flush=True)
    return int(different > 0)


if __name__ == "__main__":
    sys.exit(main())
