"""Single keys from a terminal, without waiting for a line."""

import contextlib
import os
import select
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

_MOST = 64  # characters at once
_END_OF_INPUT = "\x04"


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


class NoTerminalError(Exception):
    """There is nothing to read held keys from."""


@contextlib.contextmanager
def held_keys(source: Path | None = None) -> Iterator[Callable[[], str]]:
    """A function that returns the keys pressed since its last call, without waiting.

    source: read from this pipe instead of the terminal; its end counts as a key that ends a jog. Raises
    NoTerminalError where standard input is no terminal.
    """
    if source is None and not sys.stdin.isatty():
        raise NoTerminalError("it needs a terminal: the rig moves only while one of its keys is held")
    fd = sys.stdin.fileno() if source is None else os.open(source, os.O_RDONLY | os.O_NONBLOCK)
    before = termios.tcgetattr(fd) if source is None else None
    poll = select.poll()
    poll.register(fd, select.POLLIN)
    seen = False

    def keys() -> str:
        nonlocal seen
        if not poll.poll(0):
            return ""
        try:
            text = os.read(fd, 256).decode(errors="replace")
        except OSError:  # the terminal is gone
            return _END_OF_INPUT
        seen = seen or bool(text)
        return text or (_END_OF_INPUT if seen else "")  # a pipe that nobody writes to yet is not at its end

    try:
        if before is not None:
            tty.setcbreak(fd, termios.TCSANOW)
            termios.tcflush(fd, termios.TCIFLUSH)  # what was typed before is no consent
        yield keys
    finally:
        if before is not None:
            with contextlib.suppress(termios.error):  # the terminal is gone
                termios.tcsetattr(fd, termios.TCSADRAIN, before)
        else:
            os.close(fd)
