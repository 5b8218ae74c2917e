"""The runs of a folder with what is known of each, and which of them somebody asks for."""

import fnmatch
import math
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

from hil.analysis.figures_of_merit import NOT_SETTLED
from hil.runs.facts import facts_of
from hil.runs.index import Index
from hil.runs.kept import KeptRun, kept_runs
from hil.runs.note import Note, note_of

GROWS_NS = 3_000_000_000  # a recorder writes every half second


class ListedRun(NamedTuple):
    """A run, its facts as hil.runs.facts.facts_of gives them, and what somebody noted of it."""

    kept: KeptRun
    facts: dict[str, Any]
    note: Note

    @property
    def worst(self) -> tuple[str, float, str]:
        """(axis, RMS error, kind) of the axis with the largest RMS error, linear ones first; ("", NaN, "") of none."""
        axes = [(axis["kind"] != "linear", -axis["rms_error"], name) for name, axis in self._axes("*", None)]
        if not axes:
            return "", math.nan, ""
        rotary, error, name = min(axes)
        return name, -error, "rotary" if rotary else "linear"

    @property
    def growing(self) -> bool:
        """Whether it is still recorded: its file has no end yet, and was written to just now."""
        return bool(self.facts["missing"]) and time.time_ns() - self.kept.modified_ns < GROWS_NS

    @property
    def ended(self) -> str:
        """How it ended, in words."""
        if self.facts["outcome"] == "unread":
            return "unread"
        if self.growing:
            return "still recorded"
        return f"{self.facts['state']} {self.facts['fault'].lower()}".strip() or "-"

    @property
    def lacks(self) -> str:
        """What its figures lack, in words."""
        ticks = "ticks missing" if self.facts["missing"] and not self.growing else ""
        return ", ".join(filter(None, (ticks, "" if self.facts["settled"] else NOT_SETTLED)))

    def _axes(self, axis: str, kind: str | None) -> list[tuple[str, dict[str, Any]]]:
        return [
            (name, row)
            for name, row in self.facts["axes"].items()
            if math.isfinite(row["rms_error"]) and kind in (None, row["kind"]) and fnmatch.fnmatchcase(name, axis)
        ]

    def errors(self, axis: str, kind: str) -> list[float]:
        """RMS errors of the steady window, m (rad), of the axes with that name (a pattern) and kind."""
        return [row["rms_error"] for _, row in self._axes(axis, kind)]

    @property
    def document(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "run": str(self.kept.path),
            **self.facts,
            "bytes": self.kept.size,
            "modified_ns": self.kept.modified_ns,
            "note": self.note.text,
            "labels": [*self.note.labels],
            "note_problem": self.note.problem,
        }


class Wanted(NamedTuple):
    """Which runs. rig, law, axis: patterns as a shell has them. outcomes, labels: any of them; none: all. above, below:
    (kind, RMS error): runs with an axis above, or with all axes below.
    """

    rig: str = "*"
    law: str = "*"
    outcomes: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()
    axis: str = "*"
    above: tuple[str, float] | None = None
    below: tuple[str, float] | None = None

    def has(self, run: ListedRun) -> bool:
        """Whether the run is one of them."""
        facts = run.facts
        return (
            fnmatch.fnmatchcase(facts["rig"], self.rig)
            and fnmatch.fnmatchcase(facts["law"], self.law)
            and (not self.outcomes or facts["outcome"] in self.outcomes)
            and (not self.labels or not set(self.labels).isdisjoint(run.note.labels))
            and self._is_accurate(run)
        )

    def _is_accurate(self, run: ListedRun) -> bool:
        if self.above and not any(error > self.above[1] for error in run.errors(self.axis, self.above[0])):
            return False
        if self.below:
            errors = run.errors(self.axis, self.below[0])
            return bool(errors) and max(errors) < self.below[1]
        return True


def listed_runs(folder: Path, began: Callable[[int], Callable[[], None]]) -> list[ListedRun]:
    """Every run of a folder, the oldest first; only recordings that are new or have changed are opened.

    began: called with how many are to be read, where any are; what it returns, after each. Raises OSError where the
    folder cannot be read.
    """
    kept = kept_runs(folder)
    with Index(folder) as index:
        known = {name: index.facts(name, run.stamp) for name, run in _named(folder, kept)}
        index.forget([*(index.known.keys() - known.keys())])
        unknown = [(name, run) for name, run in _named(folder, kept) if known[name] is None]
        advance = began(len(unknown)) if unknown else lambda: None
        for name, run in unknown:
            known[name], holds = facts_of(run)
            if holds:
                index.keep(name, run.stamp, known[name] or {})
            advance()
    return [ListedRun(run, known[name] or {}, note_of(run)) for name, run in _named(folder, kept)]


def _named(folder: Path, kept: Iterable[KeptRun]) -> list[tuple[str, KeptRun]]:
    return [(run.stem if run.folder == folder else f"{run.folder.name}/{run.stem}", run) for run in kept]
