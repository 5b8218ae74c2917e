"""Traces of a bus in the formats of other tools: written only where nothing is lost; trace_file.py reads them.

candump's log is our own (candump_log.py), all others are python-can's. What each loses was found by writing every kind
of frame and reading it back (tests/runs/test_traces.py); a format that loses something is read, but not written.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import can
from can.io.blf import BLFWriter

from hil.runs.candump_log import TraceError, write_log

_NO_FD = "it has no place for the FD, BRS and ESI flags"
LOSSES = {  # suffix -> what is lost in it; "": nothing
    ".log": "",
    ".blf": "",
    ".asc": "it does not hold what an error frame says",
    ".csv": _NO_FD,
    ".db": _NO_FD,
    ".trc": "it holds classic data frames alone: no FD, remote or error frames",
}
WHOLE = tuple(suffix for suffix, loss in LOSSES.items() if not loss)


def suffix_of(file: Path) -> str:
    """The suffix that names a trace's format; .gz may follow. Raises TraceError for one that is none."""
    suffixes = [suffix.lower() for suffix in file.suffixes if suffix.lower() != ".gz"]
    if not suffixes or suffixes[-1] not in LOSSES:
        raise TraceError(f"{file}: the name must end in one of {', '.join(LOSSES)} (.gz may follow)")
    if file.suffix.lower() == ".gz" and suffixes[-1] in (".blf", ".db"):
        raise TraceError(f"{file}: {suffixes[-1]} files are not compressed once more; leave .gz away")
    return suffixes[-1]


def open_writer(file: Path) -> AbstractContextManager[Callable[[can.Message], None]]:
    """A context that takes messages. Raises TraceError for a format that would lose something, OSError."""
    suffix = suffix_of(file)
    if LOSSES[suffix]:
        raise TraceError(f"{file}: not recorded as {suffix}: {LOSSES[suffix]}; {' and '.join(WHOLE)} keep everything")
    return write_log(file) if suffix == ".log" else BLFWriter(file)
