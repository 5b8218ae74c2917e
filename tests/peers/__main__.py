"""`make peers`: peers' own tests, and peers' programs, against ours; a table of test, result and whose fault.

Ends with 1 where a difference is unexplained. What the registry does not give is "not run", and no failure.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from tests.peers import dbc_files, eds_files, margins, moves, recordings, rig_files, stacks, trace_files
from tests.peers.files import FOUND, read_and_listed
from tests.peers.own_tests import SUITES, run_suite
from tests.peers.sources import FOLDER
from tests.peers.table import Row, attributed, deviations, summary, unexplained, write


class Run(NamedTuple):
    """few: a short one. files: a folder of files to read as well, or None. work: a folder for what is made."""

    few: bool
    files: Path | None
    work: Path


def _own(run: Run) -> Iterator[Row]:
    for suite in SUITES:
        yield from run_suite(suite, few=run.few)


PARTS: dict[str, Callable[[Run], Iterable[Row]]] = {
    "own": _own,
    "eds": lambda run: eds_files.rows(run.work, run.files, few=run.few),
    "dbc": lambda run: dbc_files.rows(run.work, run.files, few=run.few),
    "traces": lambda run: trace_files.rows(run.work, run.files, few=run.few),
    "margins": lambda run: margins.rows(10 if run.few else 200),
    "moves": lambda run: moves.rows(200 if run.few else 2000),
    "recordings": lambda run: recordings.rows(run.work, few=run.few),
    "rigs": lambda run: rig_files.rows(20 if run.few else 300),
    "stacks": lambda run: stacks.rows(few=run.few),
}


def main(words: list[str] | None = None) -> int:
    """The program; the status it ends with."""
    parser = argparse.ArgumentParser(prog="make peers ARGS=...", description=__doc__)
    parser.add_argument("--few", action="store_true", help="a minute's worth: what CI runs")
    parser.add_argument("--files", type=Path, help="folder of EDS, DCF, DBC and trace files to read as well")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), help="parts to run")
    asked = parser.parse_args(words)
    if asked.files is not None and not asked.files.is_dir():
        parser.error(f"--files {asked.files}: no such folder")
    FOUND.unlink(missing_ok=True)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="hil-peers-") as work:
        run = Run(asked.few, asked.files, Path(work))
        for name in asked.only:
            begin = time.monotonic()
            found = list(PARTS[name](run))
            print(f"=== {name}: {len(found)} tests in {time.monotonic() - begin:.0f} s", flush=True)
            rows += found
    rows = attributed(rows, deviations())
    write(rows, FOLDER)
    print("\n".join([*summary(rows), read_and_listed(), f"table: {FOLDER / 'table.tsv'}"]))
    return 1 if unexplained(rows) else 0


if __name__ == "__main__":
    sys.exit(main())
