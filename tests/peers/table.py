"""The table of `make peers`: test, result, whose fault.

A test that differs is attributed by deviations.toml, or it is unexplained, and the lane fails.
"""

import json
import tomllib
from collections import Counter
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

DEVIATIONS = Path(__file__).with_name("deviations.toml")
FAULTS = ("theirs", "neither", "ours")
COLUMNS = ("peer", "test", "result", "whose fault", "why")
PASSED, DIFFERS, NOT_RUN = "passed", "differs", "not run"


class Row(NamedTuple):
    """One test. peer: whose test, or whose program ours is held against. own: it is one of the peer's own tests.

    result: PASSED, DIFFERS or NOT_RUN. told: what the test said. fault: one of FAULTS where it differs and that is
    explained; why: the explanation.
    """

    peer: str
    test: str
    result: str
    told: str = ""
    own: bool = False
    fault: str = ""
    why: str = ""


class Deviation(NamedTuple):
    """An explained difference. tests: patterns of fnmatch for names of tests."""

    peer: str
    tests: Sequence[str]
    fault: str
    why: str


def deviations(path: Path = DEVIATIONS) -> list[Deviation]:
    """All that are known. Raises ValueError for one that says nothing, or blames nobody that there is."""
    found = [Deviation(**entry) for entry in tomllib.loads(path.read_text())["deviation"]]
    for known in found:
        if known.fault not in FAULTS or not known.why or not known.tests:
            raise ValueError(f"{path.name}: {known}: fault has to be one of {', '.join(FAULTS)}, with tests and a why")
    return found


def attributed(rows: Iterable[Row], known: Sequence[Deviation]) -> list[Row]:
    """The rows; those that differ with whose fault that is, where it is known."""
    return [_attributed(row, known) if row.result == DIFFERS else row for row in rows]


def _attributed(row: Row, known: Sequence[Deviation]) -> Row:
    for deviation in known:
        if deviation.peer == row.peer and any(fnmatchcase(row.test, pattern) for pattern in deviation.tests):
            return row._replace(fault=deviation.fault, why=deviation.why)
    return row


def unexplained(rows: Iterable[Row]) -> list[Row]:
    """Those that differ, and nobody knows why."""
    return [row for row in rows if row.result == DIFFERS and not row.fault]


def summary(rows: Sequence[Row]) -> list[str]:
    """Lines for people: a line a peer, each test that differs, the count at last."""
    lines = []
    for peer in dict.fromkeys(row.peer for row in rows):
        count = Counter(row.result for row in rows if row.peer == peer)
        lines.append(f"{peer}: " + ", ".join(f"{count[result]} {result}" for result in count))
        lines += [f"  not run: {row.test}: {row.told}" for row in rows if row.peer == peer and row.result == NOT_RUN]
    for row in rows:
        if row.result == DIFFERS:
            lines.append(f"{row.peer} {row.test}: {row.fault or 'UNEXPLAINED'}: {row.why or row.told}")
    count = Counter(row.result for row in rows)
    open_rows = len(unexplained(rows))
    own = sum(row.own for row in rows)
    lines.append(
        f"ran: {count[PASSED]} passed, {count[DIFFERS] - open_rows} attributed, {open_rows} unexplained, "
        f"{count[NOT_RUN]} not run; {own} of them are peers' own tests"
    )
    return lines


def write(rows: Sequence[Row], folder: Path) -> None:
    """table.tsv for people and table.json for programs."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "table.json").write_text(json.dumps([row._asdict() for row in rows], indent=1) + "\n")
    cells = ((row.peer, row.test, row.result, row.fault, row.why or row.told) for row in rows)
    lines = ("\t".join(" ".join(cell.split())[:300] for cell in line) for line in (COLUMNS, *cells))
    (folder / "table.tsv").write_text("\n".join(lines) + "\n")
