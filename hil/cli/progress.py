"""How far a long command is: a bar with the time left at a terminal; elsewhere, as in a log, a line now and then."""

import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from hil.cli.console import plain_console

LINE_S = 30.0  # between two lines of a log


class Steps:
    """So many steps of one kind, as a context. Nothing is left of the bar; lines stay, and short work has none.

    On standard error, as it is no result.
    """

    def __init__(self, text: str, total: int, console: Console | None = None) -> None:
        console = console or plain_console(stderr=True)
        columns = (
            TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
            TimeRemainingColumn(),
        )  # fmt: skip
        self._console, self._total, self._done = console, total, 0
        self._bar = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._job = self._bar.add_task(text, total=total)
        self._begun = self._told = time.monotonic()

    def __enter__(self) -> "Steps":
        self._bar.start()
        self._begun = self._told = time.monotonic()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def advance(self, steps: int = 1, text: str = "") -> None:
        """So many more are done. text: what to say of them, or the same as before."""
        self._done += steps
        self._bar.update(self._job, advance=steps, description=text or None)
        now = time.monotonic()
        if self._console.is_terminal or now - self._told < LINE_S or self._done >= self._total:
            return
        self._told = now
        left = (now - self._begun) / self._done * (self._total - self._done)
        done = f"{self._done} of {self._total} done, about {duration(left)} left"
        self._console.print(f"{text}; {done}" if text else done, markup=False, highlight=False)


def duration(seconds: float) -> str:
    """For people: 40 s, 3 min, 2.5 h."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
