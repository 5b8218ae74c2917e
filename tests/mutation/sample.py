"""A random sample of mutants over the rooms a tick runs through, each held against its room's tests.

    python -m tests.mutation [--seed S] [--skip K] [--count N] [--minutes M] [--room R ...] [--match TEXT]
                             [--workers W] [--json OUT] [--all] [--tests FILE ...]
    python -m tests.mutation --hollow     tests that cannot fail: hollow.py
    python -m tests.mutation --careless   mistakes written down by hand, each with its test: careless.py

With `--tests` these files alone must notice, instead of all the room's: seconds a mutant become tenths, and what they
miss has no close test.

Without a seed it is the commit's hash: every change gets a slice of its own, and a second try of the same commit the
same one. Exit status 1 where the kill rate is too low, 2 as soon as a killing test also fails on the honest code.

The rule: with `n` mutants that are not explained, the run fails when the survivors would be a one-in-a-thousand event
if 95 % of all mutants were noticed. A fresh random slice of a tree that keeps its promise so hardly ever fails by
chance (of 100 mutants 13 may survive), while one whose rate has fallen to 80 % fails nine times in ten. `--all`, which
draws nothing, demands 95 % exactly.
"""

import argparse
import json
import math
import multiprocessing
import os
import random
import shutil
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from tests.mutation import careless
from tests.mutation.explained import Explained
from tests.mutation.fork_server import ForkServer
from tests.mutation.hollow import FOLDERS, green_tests
from tests.mutation.mutants import Mutant, differs, mutants_of
from tests.mutation.rooms import ROOMS, files_to_run, sources_of

ROOT = Path(__file__).resolve().parents[2]
DEMANDED = 0.95
UNFAIR = 0.001  # how often a tree that keeps what is demanded may fail by the luck of the draw


class Case(NamedTuple):
    """One mutant to be tried."""

    room: str
    mutant: Mutant
    before: str
    after: str


class Outcome(NamedTuple):
    """killer: the first test that failed, or the one that never ended; empty for a survivor."""

    case: Case
    killer: str
    hung: bool
    seconds: float


class UnfairError(Exception):
    """A test that killed a mutant fails on the honest code too, so that what it killed says nothing."""


_server: ForkServer  # of this worker
_fair: set[str] = set()  # tests that this worker has seen pass on the honest code
_closest: list[str] = []  # the test files to run, where they are named


def _start(scratch: str, tests: Sequence[str] = ()) -> None:
    global _server
    _closest[:] = tests
    _server = ForkServer(ROOT, Path(scratch))
    if tests:
        _server.collect(tests)


def _try(case: Case) -> Outcome:
    began = time.monotonic()
    path = case.mutant.path
    mutated = case.mutant.apply((_server.tree / path).read_bytes())
    quick = _server.try_swapped(path, mutated)
    if quick and quick.killed:
        return Outcome(case, quick.failed[0], quick.hung, time.monotonic() - began)
    tests = _closest or files_to_run(_server.tree, ROOMS[case.room], path)
    verdict = _server.try_mutant(path, mutated, tests)
    killer = verdict.failed[0] if verdict.failed else ""
    if killer and not verdict.hung and not killer.endswith(")"):  # no test could begin
        _refuse_unfair(killer)
    return Outcome(case, killer, verdict.hung, time.monotonic() - began)


def _refuse_unfair(killer: str) -> None:
    """Raise UnfairError for a test that fails without a mutant: at its first kill, not when all have been tried."""
    if killer not in _fair and _server.run([killer], honest=True, everything=True).failed:
        raise UnfairError(killer)
    _fair.add(killer)


def all_cases(rooms: Sequence[str], match: str) -> list[Case]:
    """Every mutant of the rooms; of the lines that contain `match`, where it is given."""
    cases = []
    for room in rooms:
        for path in sources_of(ROOT, room):
            source = (ROOT / path).read_bytes()
            for mutant in mutants_of(path, source):
                case = Case(room, mutant, *mutant.lines(source))
                if match in f"{path}: {case.before}":
                    cases.append(case)
    return cases


def draw(cases: list[Case], seed: str, count: int, skip: int = 0) -> list[Case]:
    """`count` of the cases, each as likely as any other; those that change nothing but the layout are passed over.

    skip: so many of the seed's first ones are left out, so that a long sample can be tried in parts.
    """
    random.Random(seed).shuffle(cases)
    different = (case for case in cases if differs(case.mutant, (ROOT / case.mutant.path).read_bytes()))
    return list(islice(different, skip, skip + count))


def most_survivors(tried: int, demanded: float = DEMANDED) -> int:
    """How many may survive of `tried` before the demanded rate is refuted."""
    below, k = 0.0, -1
    while below < 1.0 - UNFAIR and k < tried:
        k += 1
        below += math.comb(tried, k) * (1.0 - demanded) ** k * demanded ** (tried - k)
    return k


def _commit() -> str:
    said = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False)
    return said.stdout.strip() or time.strftime("%Y-%m-%d", time.gmtime())


def _say(number: int, total: int, outcome: Outcome) -> None:
    case = outcome.case
    how = f"hung in {outcome.killer}" if outcome.hung else outcome.killer or "SURVIVED"
    print(
        f"{number}/{total} {case.mutant.path}:{case.mutant.line} {case.mutant.kind}: {how} ({outcome.seconds:.1f} s)",
        flush=True,
    )
    if not outcome.killer:
        print(f"    - {case.before}\n    + {case.after}", flush=True)


def _by_room(outcomes: list[Outcome], explained: Explained) -> Iterator[str]:
    tried, killed, known = Counter[str](), Counter[str](), Counter[str]()
    for outcome in outcomes:
        tried[outcome.case.room] += 1
        killed[outcome.case.room] += bool(outcome.killer)
        known[outcome.case.room] += not outcome.killer and explained.covers(outcome.case)
    for room, n in tried.items():
        counted = n - known[room]
        rate = f"{100 * killed[room] / counted:.0f} %" if counted else "-"
        yield f"{room:10} {n:4} tried, {killed[room]:4} killed, {known[room]:3} survivors explained: {rate}"


def main() -> int:
    """Draw, try, report."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__.splitlines()[0])
    parser.add_argument("--seed", default="", help="any text; default: the commit's hash")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--skip", type=int, default=0, help="leave the seed's first so many out: a sample in parts")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no mutant after so many")
    parser.add_argument("--room", action="append", choices=list(ROOMS))
    parser.add_argument("--match", default="", help="only lines that contain this text, as 'path: line'")
    parser.add_argument("--tests", nargs="+", default=[], help="only these test files, instead of the room's")
    parser.add_argument("--demand", type=float, default=DEMANDED, help="rate that is demanded; default: 0.95")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--hollow", action="store_true", help="list tests that pass while the product does nothing")
    parser.add_argument("--careless", action="store_true", help="mistakes written down by hand, each with its test")
    parser.add_argument("--all", action="store_true", help="every mutant of the rooms")
    arguments = parser.parse_args()
    if arguments.hollow:
        return _list_green(arguments.workers)
    if arguments.careless:
        return careless.main(arguments.match, arguments.workers)
    seed = arguments.seed or _commit()
    cases = all_cases(arguments.room or list(ROOMS), arguments.match)
    if not arguments.room and not arguments.match:
        for line in Explained().stale(cases):
            print(f"explained, but no longer there: {line}")
    chosen = draw(cases, seed, len(cases) if arguments.all else arguments.count, arguments.skip)
    until = time.monotonic() + 60.0 * arguments.minutes
    print(f"seed {seed}: {len(chosen)} of {len(cases)} mutants", flush=True)
    scratch = tempfile.mkdtemp(prefix="m")
    outcomes = []
    try:
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(arguments.workers, spawn, _start, (scratch, arguments.tests)) as pool:
            futures = [pool.submit(_try, case) for case in chosen]
            try:
                for future in as_completed(futures):
                    if not future.cancelled():
                        outcomes.append(future.result())
                        _say(len(outcomes), len(chosen), outcomes[-1])
                    if time.monotonic() > until:
                        _cancel(futures)
            finally:
                _cancel(futures)
    except UnfairError as error:
        print(f"fails on the honest code too, so that what it kills says nothing: {error}")
        return 2
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return _judge(outcomes, arguments.json, seed, arguments.demand, exact=arguments.all)


def _cancel(futures: Iterable[Future[Outcome]]) -> None:
    for future in futures:
        future.cancel()


def _green(folder: str) -> list[str]:
    return green_tests(_server, folder)


def _list_green(workers: int) -> int:
    """The tests that stay green in a hollow product; exit status 1 where one of them is not explained."""
    scratch = tempfile.mkdtemp(prefix="m")
    try:
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers, spawn, _start, (scratch,)) as pool:
            found = [test.partition("[")[0] for tests in pool.map(_green, FOLDERS) for test in tests]
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    unexplained = sorted(set(found) - set(Explained().green))
    print(f"ran: {len(set(found))} tests passed while the product did nothing, {len(unexplained)} of them unexplained")
    print(*unexplained, sep="\n")
    return 1 if unexplained else 0


def _judge(outcomes: list[Outcome], json_path: Path | None, seed: str, demanded: float, *, exact: bool) -> int:
    explained = Explained()
    survivors = [o.case for o in outcomes if not o.killer]
    open_cases = [case for case in survivors if not explained.covers(case)]
    counted = len(outcomes) - len(survivors) + len(open_cases)
    allowed = math.floor((1.0 - demanded) * counted) if exact else most_survivors(counted, demanded)
    print(*_by_room(outcomes, explained), sep="\n")
    for case in open_cases:
        print(f"survived, unexplained: {case.mutant.path}:{case.mutant.line}\n    - {case.before}\n    + {case.after}")
    hung = sum(o.hung for o in outcomes)
    print(
        f"ran: {len(outcomes)} mutants, {len(outcomes) - len(survivors)} killed ({hung} by a time "
        f"limit), {len(survivors) - len(open_cases)} survivors explained, {len(open_cases)} not; at most {allowed}"
    )
    if json_path:
        rows = [_row(o, explained=not o.killer and explained.covers(o.case)) for o in outcomes]
        json_path.write_text(json.dumps({"seed": seed, "mutants": rows}, indent=1))
    return 1 if len(open_cases) > allowed or not outcomes else 0


def _row(outcome: Outcome, *, explained: bool) -> dict[str, object]:
    case = outcome.case
    row = {"room": case.room, **case.mutant._asdict(), "text": case.mutant.text.decode()}
    row |= {"before": case.before, "after": case.after, "killer": outcome.killer, "hung": outcome.hung}
    return row | {"seconds": round(outcome.seconds, 2), "explained": explained}
