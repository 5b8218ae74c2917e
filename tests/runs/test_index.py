"""The index of runs: used where it can be, made anew where it cannot, and never needed."""

import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hil.runs import listed
from hil.runs.facts import facts_of
from hil.runs.index import index_file
from hil.runs.kept import KeptRun
from tests.support.listed import command, known, put


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the folders whose recordings were read."""
    found: list[str] = []

    def counted(run: KeptRun) -> tuple[dict[str, Any], bool]:
        found.append(run.folder.name)
        return facts_of(run)

    monkeypatch.setattr(listed, "facts_of", counted)
    return found


def test_only_what_is_new_or_has_changed_is_read(runs: Path, recording: Path, read: list[str]) -> None:
    for name in "abc":
        put(runs, name, recording)
    known(runs)
    put(runs, "d", recording)
    (runs / "b" / "run.mcap").unlink()
    (runs / "b" / "run.mcap").write_bytes(recording.read_bytes()[:-100])
    (runs / "a" / "run.mcap").unlink()
    (runs / "a").rmdir()
    read.clear()
    assert len(known(runs)) == 3
    assert sorted(read) == ["b", "d"]
    base = sqlite3.connect(index_file())
    assert base.execute("SELECT count(*) FROM runs").fetchone() == (3,)  # none of what is gone
    base.close()


def missing() -> None:
    index_file().unlink()


def damaged() -> None:
    index_file().write_bytes(b"no database" * 1000)


def of_another_format() -> None:
    base = sqlite3.connect(index_file())
    base.executescript("DROP TABLE runs; CREATE TABLE runs (other TEXT); PRAGMA user_version = 999")
    base.close()


def with_another_table() -> None:
    base = sqlite3.connect(index_file())
    base.executescript("DROP TABLE runs; CREATE TABLE runs (other TEXT)")
    base.close()


def of_another_version_of_hil() -> None:
    base = sqlite3.connect(index_file())
    base.executescript("UPDATE runs SET stamp = 'x' || stamp")
    base.close()


def with_facts_that_are_none() -> None:
    base = sqlite3.connect(index_file())
    base.executescript("UPDATE runs SET facts = '[1'")
    base.close()


@pytest.mark.parametrize(
    "spoil",
    [missing, damaged, of_another_format, with_another_table, of_another_version_of_hil, with_facts_that_are_none],
)
def test_an_index_that_is_no_use_is_made_anew(
    spoil: Callable[[], None], runs: Path, recording: Path, read: list[str]
) -> None:
    put(runs, "a", recording)
    first = known(runs)
    spoil()
    assert known(runs) == known(runs) == first
    assert read == ["a", "a"]


def test_without_a_place_for_the_index_runs_are_read_each_time(
    runs: Path, recording: Path, read: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    put(runs, "a", recording)
    monkeypatch.setenv("XDG_CACHE_HOME", str(recording))  # a file: no folder can be made in it
    assert known(runs) == known(runs)
    assert read == ["a", "a"]


def test_an_index_that_others_may_write_to_is_not_believed(runs: Path, recording: Path, read: list[str]) -> None:
    put(runs, "a", recording)
    known(runs)
    index_file().parent.chmod(0o777)
    known(runs)
    assert read == ["a", "a"]


def test_a_list_writes_nothing_into_the_folder_of_the_runs(runs: Path, recording: Path) -> None:
    put(runs, "a", recording)
    before = sorted(runs.rglob("*")), [path.stat().st_mtime_ns for path in (runs, runs / "a")]
    assert command().exit_code == 0
    assert (sorted(runs.rglob("*")), [path.stat().st_mtime_ns for path in (runs, runs / "a")]) == before
