"""The facts of runs that were read before, in a cache of this user: a list of a thousand then opens no recording.

It holds nothing that is not in the files: where it is missing, damaged, of another version or not to be written, runs
are read again. It lies in the user's own cache folder, so a folder of runs that came from elsewhere brings none.
"""

import contextlib
import json
import os
import sqlite3
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from drivers.base.runtime import cache_folder, is_private

FORMAT = 2  # of the facts and the table; another number, or another version of hil, reads the runs again
_TABLE = """CREATE TABLE IF NOT EXISTS runs
    (folder BLOB, name TEXT, stamp TEXT, facts TEXT, PRIMARY KEY (folder, name)) WITHOUT ROWID"""
_WAIT_S = 2.0  # for another process that writes to it


def index_file() -> Path:
    """Where the cache is."""
    return cache_folder() / "runs.sqlite"


class Index:
    """The facts of the runs of one folder; a context. `known` is by name. Nothing raises where there is no cache."""

    def __init__(self, folder: Path) -> None:
        self._folder = os.fsencode(folder.resolve())
        self._version = f"{FORMAT} {version('hil')}\n"
        self._base = _opened()
        self.known: Mapping[str, tuple[str, str]] = self._read()

    def __enter__(self) -> "Index":
        return self

    def __exit__(self, *_: object) -> None:
        if self._base is not None:
            self._base.close()

    def facts(self, name: str, stamp: str) -> dict[str, Any] | None:
        """What is known of a run whose files have this stamp."""
        was, text = self.known.get(name, ("", ""))
        if was != self._version + stamp:
            return None
        with contextlib.suppress(ValueError):
            found = json.loads(text)
            return found if isinstance(found, dict) else None
        return None

    def _read(self) -> Mapping[str, tuple[str, str]]:
        if self._base is None:
            return {}
        try:
            rows = self._base.execute("SELECT name, stamp, facts FROM runs WHERE folder = ?", (self._folder,))
            return {name: (stamp, facts) for name, stamp, facts in rows}
        except sqlite3.Error:
            self._give_up()
            return {}

    def keep(self, name: str, stamp: str, facts: dict[str, Any]) -> None:
        """From now on this is known."""
        row = (self._folder, name, self._version + stamp, json.dumps(facts))
        self._write("INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?)", [row])

    def forget(self, names: Sequence[str]) -> None:
        """Of runs that are gone."""
        self._write("DELETE FROM runs WHERE folder = ? AND name = ?", [(self._folder, name) for name in names])

    def _write(self, statement: str, rows: Sequence[tuple[Any, ...]]) -> None:
        if self._base is None or not rows:
            return
        try:
            self._base.executemany(statement, rows)
            self._base.commit()
        except (sqlite3.Error, UnicodeError):  # UnicodeError: a name that is no text
            with contextlib.suppress(sqlite3.Error):
                self._base.rollback()

    def _give_up(self) -> None:
        if self._base is not None:
            self._base.close()
        self._base = None


def _opened() -> sqlite3.Connection | None:
    """The cache, made anew where it is damaged or of another format; None where it cannot be."""
    file = index_file()
    try:
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not is_private(file.parent):
            return None
        for _ in range(2):
            with contextlib.suppress(sqlite3.DatabaseError):
                return _connected(file)
            file.unlink(missing_ok=True)
    except (OSError, sqlite3.OperationalError):
        return None
    return None


def _connected(file: Path) -> sqlite3.Connection:
    """Raises sqlite3.DatabaseError where the file is no cache of this format, OSError where it cannot be used now."""
    base = sqlite3.connect(file, timeout=_WAIT_S)
    try:
        base.execute("PRAGMA trusted_schema = OFF")
        base.execute("PRAGMA synchronous = OFF")  # a cache: what a power cut damages is made anew
        (found,) = base.execute("PRAGMA user_version").fetchone()
        if found not in (0, FORMAT):
            raise sqlite3.DatabaseError("a cache of another format")
        base.execute(_TABLE)
        base.execute(f"PRAGMA user_version = {FORMAT}")
        base.execute("SELECT folder, name, stamp, facts FROM runs LIMIT 1").fetchall()
        base.commit()
    except sqlite3.OperationalError as error:
        base.close()
        if "no such column" in str(error):
            raise sqlite3.DatabaseError("a table of another form") from None
        raise OSError(f"{file}: {error}") from None  # locked, read-only, full
    except BaseException:
        base.close()
        raise
    return base
