"""Single keys from a terminal, without waiting for a line."""

import os
import select
import termios
import time
import tty
from contextlib import AbstractContextManager
from typing import Any

_MOST = 64  # characters at once


class Keys(AbstractContextManager["Keys"]):
    """The keys of a terminal while open; afterwards it is as it was."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._before: list[Any] | None = None

    def __enter__(self) -> "Keys":
        if os.isatty(self._fd):
            self._before = termios.tcgetattr(self._fd)
            tty.setcbreak(self._fd, termios.TCSANOW)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before:
            termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)

    def within(self, seconds: float) -> str:
        """What was pressed, once something is within that time; empty where nothing is."""
        if self._before is None:
            time.sleep(seconds)
            return ""
        ready, _, _ = select.select([self._fd], [], [], seconds)
        return os.read(self._fd, _MOST).decode(errors="replace") if ready else ""
