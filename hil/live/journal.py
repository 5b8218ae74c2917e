"""The control process' end of its journal: a child that tells its events (hil/live/teller.py)."""

import contextlib
import os
import signal
import subprocess
import sys

from hil.live.runtime_paths import RuntimePaths

_ENDING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
TOLD_WITHIN_S = 2.0  # at the end; who reads its lines may be slow


class Journal:
    """Starts the child for the ring that this process is about to make. Raises OSError."""

    def __init__(self, paths: RuntimePaths) -> None:
        words = [sys.executable, "-P", "-m", "hil.live.teller", str(paths.ring), str(paths.notes), str(os.getpid())]
        # Signals to all processes of a terminal or a service are meant for this one, whose end is to be told, too. The
        # child keeps them blocked from its first instant on.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
        try:
            self._child = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def end(self) -> None:
        """The ring is closed: wait until all of it is told."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._child.wait(TOLD_WITHIN_S)

    def leave(self) -> None:
        """Not waited for: it ends after this process."""
        if self._child.returncode is None:
            self._child.returncode = 0  # no warning when the object is deleted
