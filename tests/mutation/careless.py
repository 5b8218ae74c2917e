"""Mistakes that a careless hand makes, written down one by one: each is tried, and its own test has to notice.

    python -m tests.mutation --careless [--match TEXT] [--workers W]

careless/*.toml is the table: kind (stale: an old value is used; order: two steps in the wrong order; clock: the wrong
instant; reset: state that stays; axis: of another axis; bound: a limit that is not held; count: a number that is not
kept), file, before and after (text that stands once in the file), and killer, the test that notices. A row that no
test needs to notice has `why` in its place, and is not tried. Exit status 1 where a mistake goes unnoticed, 2 where
the test that noticed fails on the honest code, too.
"""

import multiprocessing
import shutil
import tempfile
import tomllib
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

from tests.mutation.fork_server import ForkServer
from tests.mutation.rooms import ROOMS, files_to_run, sources_of

ROOT = Path(__file__).resolve().parents[2]
TABLES = Path(__file__).with_name("careless")
KINDS = ("stale", "order", "clock", "reset", "axis", "bound", "count")


class Mistake(NamedTuple):
    """One row of the table."""

    kind: str
    file: str
    before: str
    after: str
    killer: str = ""
    why: str = ""

    @property
    def name(self) -> str:
        """File and first changed line, for people."""
        lines = zip(self.before.splitlines(), self.after.splitlines(), strict=False)
        changed = [before for before, after in lines if before != after] or self.before.splitlines()[-1:]
        return f"{self.file}: {self.kind}: {changed[0].strip()}"


class Found(NamedTuple):
    """killer: the test that failed; empty: none did. fair: it passes on the honest code."""

    mistake: Mistake
    killer: str
    fair: bool


def table() -> list[Mistake]:
    """All rows, file by file."""
    rows = [row for path in sorted(TABLES.glob("*.toml")) for row in tomllib.loads(path.read_text())["careless"]]
    return [Mistake(**row) for row in rows]


def mutated(mistake: Mistake, source: str) -> str:
    """The file with the mistake in it. Raises ValueError where its text does not stand there once."""
    if source.count(mistake.before) != 1:
        raise ValueError(f"{mistake.name}: stands {source.count(mistake.before)} times in the file")
    return source.replace(mistake.before, mistake.after)


_server: ForkServer  # of this worker


def _start(scratch: str) -> None:
    global _server
    _server = ForkServer(ROOT, Path(scratch))


def _try(mistake: Mistake) -> Found:
    tree, path = _server.tree, mistake.file
    room = next(name for name in ROOMS if path in sources_of(ROOT, name))
    tests = [*([mistake.killer] if mistake.killer else []), *files_to_run(tree, ROOMS[room], path)]
    verdict = _server.try_mutant(path, mutated(mistake, (tree / path).read_text()).encode(), tests)
    killer = verdict.failed[0] if verdict.failed else ""
    if not killer or verdict.hung or killer.endswith(")"):  # a time limit, or no test could begin
        return Found(mistake, killer, fair=True)
    return Found(mistake, killer, not _server.run([killer], honest=True, everything=True).failed)


def main(match: str, workers: int) -> int:
    """Try every mistake whose name contains `match`; the exit status."""
    rows = [mistake for mistake in table() if match in mistake.name]
    chosen = [mistake for mistake in rows if not mistake.why]
    scratch = tempfile.mkdtemp(prefix="m")
    found = []
    try:
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers, spawn, _start, (scratch,)) as pool:
            for one in pool.map(_try, chosen):
                found.append(one)
                print(f"{len(found)}/{len(chosen)} {one.mistake.name}: {_said(one)}", flush=True)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return _judge(found, len(rows) - len(chosen))


def _said(one: Found) -> str:
    if not one.killer:
        return "NOT NOTICED"
    moved = "" if one.killer == one.mistake.killer else f", not by {one.mistake.killer or 'a named test'}"
    return f"{one.killer}{moved}" + ("" if one.fair else " (fails on the honest code, too)")


def _judge(found: list[Found], explained: int) -> int:
    kinds = Counter(one.mistake.kind for one in found)
    noticed = sum(bool(one.killer) for one in found)
    print("kinds: " + ", ".join(f"{kind} {number}" for kind, number in sorted(kinds.items())))
    print(f"ran: {len(found)} mistakes, {noticed} noticed; {explained} more are explained")
    if not all(one.fair for one in found):
        return 2
    return 0 if found and noticed == len(found) else 1
