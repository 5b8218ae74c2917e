"""Why drives were refused, in words: from the control process to the journal, and by a file to sidecar and monitor."""

import contextlib
import sys
from collections.abc import Sequence
from pathlib import Path

from drivers.runtime import read_private, write_private

_MOST = 16  # lines
_LONGEST = 400  # characters of a line


class DriveProblems:
    """The control process' side. told: what was last written."""

    def __init__(self, path: Path) -> None:
        self.told: tuple[str, ...] = ()
        self._path = path
        path.unlink(missing_ok=True)

    def tell(self, problems: Sequence[str]) -> None:
        """Write what is new to standard error (the journal) and to the file. Not for a tick that applies torque."""
        new = tuple(problem[:_LONGEST] for problem in problems[:_MOST])
        if new == self.told:
            return
        fresh = [problem for problem in new if problem not in self.told]
        self.told = new
        with contextlib.suppress(OSError):  # the terminal or the runtime directory is gone: the loop goes on
            write_private(self._path, "".join(f"{problem}\n" for problem in new))
            for problem in fresh:
                print(f"hil run: drive not ready: {problem}", file=sys.stderr, flush=True)


def read_problems(path: Path) -> list[str]:
    """What the control process wrote last; nothing where there is none."""
    try:
        return read_private(path).decode(errors="replace").splitlines()[:_MOST]
    except OSError:
        return []
