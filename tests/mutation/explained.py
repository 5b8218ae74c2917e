"""Survivors that need no test, by content: a file, a line of it, what the mutant makes of it, and why that is well."""

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any


class Explained:
    """The tables in explained/, of survivors, and in green.toml, of tests that stay green in a hollow product."""

    def __init__(self) -> None:
        here = Path(__file__).parent
        self.rows = [row for path in sorted((here / "explained").glob("*.toml")) for row in _rows(path, "survivor")]
        self.green: dict[str, str] = {row["test"]: row["why"] for row in _rows(here / "green.toml", "green")}
        self._known = {(row["file"], row["line"], row["mutant"]) for row in self.rows}

    def covers(self, case: Any) -> bool:
        """Whether this mutant's survival is explained."""
        return (case.mutant.path, case.before, case.after) in self._known

    def stale(self, cases: Iterable[Any]) -> list[str]:
        """Explanations of mutants that are no longer among all cases: their lines have changed, or gone."""
        there = {(case.mutant.path, case.before, case.after) for case in cases}
        return sorted(f"{file}: {line}" for file, line, mutant in self._known - there)


def _rows(path: Path, table: str) -> list[dict[str, str]]:
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    rows: list[dict[str, str]] = document[table]
    return rows
