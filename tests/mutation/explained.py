"""Survivors that need no test, by content: a file, a line of it, what the mutant makes of it, and why that is well."""

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any


class Explained:
    """The tables in explained.toml, of survivors, and in green.toml, of tests that stay green in a hollow product."""

    def __init__(self) -> None:
        self.rows = _rows("explained.toml", "survivor")
        self.green: dict[str, str] = {row["test"]: row["why"] for row in _rows("green.toml", "green")}
        self._known = {(row["file"], row["line"], row["mutant"]) for row in self.rows}

    def covers(self, case: Any) -> bool:
        """Whether this mutant's survival is explained."""
        return (case.mutant.path, case.before, case.after) in self._known

    def stale(self, cases: Iterable[Any]) -> list[str]:
        """Explanations of mutants that are no longer among all cases: their lines have changed, or gone."""
        there = {(case.mutant.path, case.before, case.after) for case in cases}
        return sorted(f"{file}: {line}" for file, line, mutant in self._known - there)


def _rows(name: str, table: str) -> list[dict[str, str]]:
    document = tomllib.loads((Path(__file__).parent / name).read_text(encoding="utf-8"))
    rows: list[dict[str, str]] = document[table]
    return rows
