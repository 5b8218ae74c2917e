"""Which runs a folder holds: names, sizes and ages of their files. No recording is opened here."""

import errno
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from drivers.base.text_file import words_of

# run.mcap of a folder's first control process, run-2.mcap of the next, run.part-2.mcap where one goes on; black boxes.
_RECORDING = re.compile(r"((?:run|blackbox)(?:-\d+)?)(?:\.part-(\d+))?\.mcap")
_MADE_FOR_A_RUN = re.compile(r"\d{8}-\d{6}(-\d+)?")  # hil.telemetry.blackbox.run_directory


class KeptRun(NamedTuple):
    """One control process' recording. files: in the order of its parts. stamp: differs as soon as one of them does.
    modified_ns: wall clock, of the newest. problem: why there is nothing to read; empty where there is.
    """

    folder: Path
    stem: str
    files: tuple[Path, ...]
    size: int
    modified_ns: int
    stamp: str
    problem: str = ""

    @property
    def path(self) -> Path:
        """What other commands take as RUN."""
        return self.folder if self.stem == "run" and self.files[:1] == (self.folder / "run.mcap",) else self.first

    @property
    def first(self) -> Path:
        """The file that a reader begins with."""
        return self.files[0] if self.files else self.folder


def kept_runs(folder: Path) -> list[KeptRun]:
    """The runs of a folder and of the folders in it, the oldest first. Raises OSError where `folder` cannot be read."""
    found = list(_runs_in(folder, inner=False))
    for entry in sorted(_folders(folder)):
        found += _runs_in(entry, inner=True)
    return sorted(found, key=lambda run: (run.modified_ns, run.path))


def _folders(folder: Path) -> list[Path]:
    with os.scandir(folder) as entries:
        return [folder / entry.name for entry in entries if not entry.name.startswith(".") and entry.is_dir()]


def _runs_in(folder: Path, *, inner: bool) -> Iterator[KeptRun]:
    parts: dict[str, list[tuple[int, Path, os.stat_result | OSError]]] = {}
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if named := _RECORDING.fullmatch(entry.name):
                    part = (int(named[2] or 1), folder / entry.name, _status(entry))
                    parts.setdefault(named[1], []).append(part)
    except OSError as error:
        if not inner:
            raise
        yield KeptRun(folder, "run", (), 0, _modified_ns(folder), "", words_of(error))
        return
    if inner and not parts and _MADE_FOR_A_RUN.fullmatch(folder.name):
        yield KeptRun(folder, "run", (), 0, _modified_ns(folder), "", "it holds no recording")
    for stem, found in parts.items():
        yield _run(folder, stem, sorted(found, key=lambda part: part[0]))


def _run(folder: Path, stem: str, parts: list[tuple[int, Path, os.stat_result | OSError]]) -> KeptRun:
    files = tuple(path for _, path, _ in parts)
    known = [status for _, _, status in parts if not isinstance(status, OSError)]
    problem = next((f"{path.name}: {status.strerror}" for _, path, status in parts if isinstance(status, OSError)), "")
    lines = [f"{path.name} {status.st_size} {status.st_mtime_ns}" for path, status in zip(files, known, strict=False)]
    newest = max((status.st_mtime_ns for status in known), default=_modified_ns(folder))
    return KeptRun(folder, stem, files, sum(s.st_size for s in known), newest, "\n".join(lines), problem)


def _status(entry: os.DirEntry[str]) -> os.stat_result | OSError:
    try:
        return entry.stat()
    except OSError as error:  # a link to nothing
        return error


def _modified_ns(folder: Path) -> int:
    try:
        return folder.stat().st_mtime_ns
    except OSError:
        return 0


def kept_run(path: Path) -> KeptRun:
    """The run that a folder (its first one) or a recording stands for. Raises FileNotFoundError, OSError."""
    folder = path if path.is_dir() else path.parent
    found = list(_runs_in(folder, inner=False))
    named = _RECORDING.fullmatch(path.name)
    wanted = [run for run in found if path.is_dir() or (named and path in run.files)]
    if not wanted:
        raise FileNotFoundError(errno.ENOENT, "no run.mcap or blackbox.mcap of a run", str(path))
    return next((run for run in wanted if run.stem == "run"), wanted[0])
