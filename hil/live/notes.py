"""What the cycle says in words (hil/cycle/note.py): by a file from the control process to all others."""

import contextlib
import json
from pathlib import Path

from drivers.runtime import read_private, write_private
from hil.cycle.event_table import Kind
from hil.cycle.note import MOST, Note, Speaker, noted


class NoteWriter:
    """The control process' side. told: what was last written."""

    def __init__(self, path: Path) -> None:
        self.told: tuple[Note, ...] = ()
        self._path = path
        path.unlink(missing_ok=True)

    def write(self, speaker: Speaker, tick: int, now_ns: int) -> None:
        """Write what is said, if it is other than before. Not for a tick that applies torque: writing may wait."""
        new = noted(speaker, self.told, tick, now_ns)
        if new == self.told:
            return
        self.told = new
        with contextlib.suppress(OSError):  # the runtime directory is gone: the loop goes on
            write_private(self._path, "".join(f"{json.dumps(note)}\n" for note in new))


def read_notes(path: Path) -> list[Note]:
    """What the control process wrote last; nothing where there is none, or no sense in it."""
    notes = []
    try:
        for line in read_private(path).decode().splitlines()[:MOST]:
            kind, text, tick, time_ns = json.loads(line)
            notes.append(Note(Kind(kind), str(text), int(tick), int(time_ns)))
    except (OSError, ValueError, TypeError):
        return []
    return notes


def read_problems(path: Path) -> list[str]:
    """Of what was written last, why drives were refused or an axis is not as stated."""
    return [note.text for note in read_notes(path) if note.kind is Kind.DRIVE]
