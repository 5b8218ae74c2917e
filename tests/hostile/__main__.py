"""python -m tests.hostile: every command in surroundings that are against it; a slice by default drawn by the commit.

Prints what was not right: the command, the surroundings, why, and what it said. Exit status 1: some were not.
"""

import argparse
import hashlib
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tests.hostile.commands import CASES, Case
from tests.hostile.judge import wrong
from tests.hostile.started import Ended, run
from tests.hostile.surroundings import SURROUNDINGS, Surroundings, make_cgroup, make_memory_cgroup
from tests.support.lanes import commit
from tests.support.paths import RIGS, ROOT

_INSIDE = "HOSTILE_LANE_INSIDE"


def inputs(folder: Path) -> None:
    """What the commands read: two runs, a cut recording, rigs, a drive's EDS, a trace, rows of a stream."""
    import hil

    for name in ("run", "other"):
        (folder / name).mkdir(parents=True)
        hil.simulate("paper", 0.5, record=folder / name / "run.mcap")
    whole = (folder / "run" / "run.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    for name, of in (("rig", "paper"), ("small", "paper"), ("cells", "microscope")):
        shutil.copy(RIGS / f"{of}.toml", folder / f"{name}.toml")
    shutil.copy(ROOT / "drivers/families/cia402/cia402.eds", folder / "drive.eds")
    (folder / "trace.log").write_text("(0.000000) can0 123#00\n(0.010000) can0 123#01\n")
    (folder / "rows.csv").write_text("t,x\n0,0\n1,0.001\n")
    subprocess.run(["chmod", "-R", "a+rX", folder], check=True)


def have() -> set[str]:
    """What surroundings may need: mounts of one's own, root, cgroups, the guest of the VM lane."""
    found = {"mounts"} if os.environ.get(_INSIDE) == "yes" else set()
    if os.geteuid() == 0 and Path("/proc/self/uid_map").read_text().split()[2] != "1":
        found.add("root")
        if make_cgroup():
            found.add("cgroup")
        if make_memory_cgroup():
            found.add("memory cgroup")
        if "virtme" in Path("/proc/cmdline").read_text():
            found.add("guest")  # whose clock and cores are nobody else's
    return found


def rank(name: str, weight: float, seed: str) -> float:
    """A place in the order, which another commit draws anew; with more weight, sooner."""
    drawn = int.from_bytes(hashlib.sha256(f"{seed} {name}".encode()).digest()[:8]) + 1
    return (64.0 * math.log(2.0) - math.log(drawn)) / weight


def pairs(only: str, there: set[str], seed: str, part: int = 0, parts: int = 1) -> list[tuple[str, str]]:
    """(command, surroundings) in the order in which they are tried; part: of how many, no command in two of them."""
    names = [
        (case, name)
        for case in sorted(CASES)[part::parts]
        for name, over in SURROUNDINGS.items()
        if there.issuperset(over.needs) and only in f"{case}: {name}"
    ]
    return sorted(names, key=lambda pair: rank(f"{pair[0]}: {pair[1]}", SURROUNDINGS[pair[1]].weight, seed))


class Lane:
    """Runs pairs one after the other. A command that gets a signal runs once undisturbed before, to know how long."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.number = folder, 0
        self.took_s: dict[str, float] = {}
        inputs(folder / "in")

    def run(self, case: Case, over: Surroundings, plain_s: float = 0.0) -> Ended:
        """In a place of its own."""
        self.number += 1
        return run(case, over, self.folder / "in", self.folder / f"at{self.number}", plain_s)

    def tried(self, name: str, at: str) -> tuple[str, Ended]:
        """(what is wrong, or nothing; how it ended)."""
        case, over = CASES[name], SURROUNDINGS[at]
        if over.number is not None and name not in self.took_s:
            self.took_s[name] = self.run(case, SURROUNDINGS["undisturbed"]).seconds
        ended = self.run(case, over, self.took_s.get(name, 0.0))
        return wrong(case, over, ended), ended


def _show(name: str, at: str, why: str, ended: Ended) -> None:
    print(f"FAILED {name}, {at}: {why}")
    for text in (ended.out, ended.err):
        for line in (text or "").strip().splitlines()[-6:]:
            print(f"    {line[:200]}")
    sys.stdout.flush()


def main(arguments: Sequence[str]) -> int:
    """Returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.hostile", description=__doc__)
    parser.add_argument("--minutes", type=float, default=3.0, help="begin no other run after this time")
    parser.add_argument("--only", default="", help="pairs with this in `COMMAND: SURROUNDINGS`")
    parser.add_argument("--pairs", type=int, default=None, help="try so many of them [as many as there is time for]")
    parser.add_argument("--seed", default=commit(), help="of the order [the commit]")
    parser.add_argument("--part", default="0/1", help="K/N: the Kth part of the commands, to run beside the others")
    parser.add_argument("--held", type=Path, help="skip the pairs in this file, and add those that hold")
    asked = parser.parse_args(arguments)
    there = have()
    for name in {need for over in SURROUNDINGS.values() for need in over.needs} - there:
        print(f"NOT RUN: what needs {name}")
    until = time.monotonic() + 60.0 * asked.minutes
    part, parts = map(int, asked.part.split("/"))
    before = set(asked.held.read_text().splitlines()) if asked.held and asked.held.exists() else set()
    chosen = pairs(asked.only, there, asked.seed, part, parts)[: asked.pairs]
    chosen = [pair for pair in chosen if ": ".join(pair) not in before]
    with tempfile.TemporaryDirectory(prefix="hil-hostile-") as directory:
        os.chmod(directory, 0o755)
        lane = Lane(Path(directory))
        done = failed = 0
        for name, at in chosen:
            if time.monotonic() > until:
                break
            why, ended = lane.tried(name, at)
            done += 1
            if why:
                failed += 1
                _show(name, at, why, ended)
            elif asked.held:
                with asked.held.open("a") as file:
                    print(f"{name}: {at}", file=file)
    print(f"ran: {done} of {len(chosen)} pairs of command and surroundings, {done - failed} held")
    return 1 if failed or not done else 0


def _with_own_mounts(arguments: Sequence[str]) -> int:
    """The lane again where nobody else sees its mounts; as it is where the kernel refuses that."""
    for words in (["unshare", "-m"], ["unshare", "-rm"]):
        if subprocess.run([*words, "true"], capture_output=True, check=False).returncode == 0:
            environment = {**os.environ, _INSIDE: "yes"}
            return subprocess.run(
                [*words, sys.executable, "-m", "tests.hostile", *arguments], env=environment, check=False
            ).returncode
    return main(arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]) if _INSIDE in os.environ else _with_own_mounts(sys.argv[1:]))
