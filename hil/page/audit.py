"""Every request to the page: who, from where, what, and what became of it."""

import contextlib
import json
import os
import time
from pathlib import Path
from typing import Any, Final

from drivers.base.runtime import open_private

LARGEST: Final = 4 * 2**20  # bytes; then the file gives way to a new one, and the one before it goes
_LONGEST: Final = 200  # characters of a text


class Audit:
    """A file of JSON lines, and for the journal those that asked for something or were refused. path: the file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def note(self, who: str, address: str, what: str, status: int, said: str = "") -> None:
        """One request. what: method and path. said: the verdict's words. A disk that is full stops nothing."""
        entry: dict[str, Any] = {
            "time": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "who": who,
            "from": address,
            "what": what[:_LONGEST],
            "status": status,
            "said": said[:_LONGEST],
        }
        line = json.dumps(entry)  # in ASCII: what would command a terminal is spelt out
        if status >= 400 or not what.startswith("GET "):
            print(f"hil page: {line}", flush=True)
        with contextlib.suppress(OSError):
            self._append(line)

    def _append(self, line: str) -> None:
        fd = open_private(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        try:
            os.write(fd, f"{line}\n".encode())
            full = os.fstat(fd).st_size > LARGEST
        finally:
            os.close(fd)
        if full:
            self._path.replace(self._path.with_name(f"{self._path.name}.1"))
